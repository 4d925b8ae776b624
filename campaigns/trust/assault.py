"""Does the attacks of a siege to the nodes of a stage."""

from __future__ import annotations

import itertools
import os
import shutil
import signal
import threading
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy._rclpy_pybind11 import RCLError
from rclpy.context import Context
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from trust.adversary import SEQUENCE, WORDS, interface, leaves
from trust.attacks import Attack, Inventory, Step, adversary
from trust.sieges.siege_gauges import DEAD, FEEDBACK
from trust.sieges.siege_payload import MOVES, RESTS, SETTLED
from trust.sieges.siege_scenes import FALLEN_SILENT, FEED
from trust.sieges.siege_stage import ANSWER, SiegeStage
from trust.sockets import attack_page

from denoc_ros.cli.warmup_verb import HEAVY, all_kernels
from denoc_ros.kernels.jit.cache import SUFFIX
from denoc_ros.trajectories import SplineTrajectory

STROKE, LASTING = 0.05, 1.0  # rad or m, and s, of a motion that is stopped on its way
STARTING, STOPPING = 5.0, 2.0  # s until a motion is planned, and until it is over
SAME_PLACE, SAME_RATE = 1e-4, 1e-3  # rad or m, and per s
TRIGGER = 'std_srvs/srv/Trigger'
END = 20.0  # s within which a process that is told to has ended
NOTICED = 0.5  # s until a process that is busy has said that it lets go
TOPICS = 12  # names of strange topics
STRANGE = (
    'std_msgs/msg/String', 'std_msgs/msg/Float64', 'sensor_msgs/msg/Imu', 'nav_msgs/msg/Odometry',
    'geometry_msgs/msg/WrenchStamped', 'trajectory_msgs/msg/JointTrajectory',
    'visualization_msgs/msg/MarkerArray', 'diagnostic_msgs/msg/DiagnosticArray',
)  # fmt: skip
BOMB = (
    '<!DOCTYPE robot [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">'
    '<!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;">]><robot name="&c;"/>'
)


class Assault:
    """Does steps.

    Attributes
    ----------
    tally : dict of str to Counter
        What was sent, by node.
    asked : dict of str to float
        Nodes that were told to end in the step at hand, and whose end is due.
    killed : set of str
        Of these, those that were not asked.
    """

    def __init__(self, stage: SiegeStage, inventory: Inventory) -> None:
        self.stage, self.inventory = stage, inventory
        self.tally: Counter[tuple[str, str]] = Counter()
        self.asked: set[str] = set()
        self.killed: set[str] = set()
        self.unanswered: list[tuple[str, str]] = []
        self.spoilt = False  # whether the recorder's files were, in the step at hand
        self._lock = threading.Lock()

    def do(self, step: Step) -> None:
        """Do all attacks of a step at once; return when all are over."""
        self.asked.clear()
        self.killed.clear()
        self.unanswered.clear()
        self.spoilt = False
        threads = [threading.Thread(target=self._do, args=(a,), daemon=True) for a in step]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(4.0 * ANSWER)
            if thread.is_alive():
                raise RuntimeError(f'an attack must come to an end: {step}')

    def _do(self, attack: Attack) -> None:
        try:
            getattr(self, f'_{attack["do"]}')(attack)
        except Exception as error:
            # the siege's own fault, not the nodes': said, and no law
            print(f'attack failed: {type(error).__name__}: {error}: {attack}', flush=True)

    def _count(self, node: str, what: str, number: int = 1) -> None:
        with self._lock:
            self.tally[node, what] += number

    # ---- messages

    def _good(self, topic: str, kind: str) -> Any:
        """Return a good message of a topic."""
        if topic == '/strain' and self.stage.scene.gauges:
            return self.stage.gauges.message(self.stage.now_ns())
        if topic == '/joint_states' or kind == 'sensor_msgs/msg/JointState':
            return self.stage.state()
        if topic in ('/reference', self.stage.scene.plans_for):
            return self.stage.trajectory(0.2)
        return interface(kind)()

    def _messages(self, attack: Attack) -> None:
        stage, topic, kind = self.stage, attack['topic'], attack['type']
        rng = adversary(attack['seed'], self.inventory, attack['node'])
        publisher = stage.publisher(topic, interface(kind))
        end = time.perf_counter() + 2.0
        with ExitStack() as stack:
            if attack['instead'] and topic == '/joint_states':
                stack.enter_context(stage.silenced())
            if attack['second']:
                publisher = stage.node.create_publisher(interface(kind), topic, 10)
                stack.callback(stage.node.destroy_publisher, publisher)
            for _ in range(attack['count']):
                if attack['same']:
                    rng = adversary(attack['seed'], self.inventory, attack['node'])
                good = self._good(topic, kind)
                if 'length' in attack:
                    lengthen(good, rng.one_of, attack['length'])
                publisher.publish(good if 'length' in attack else rng.sent(kind, good))
                self._count(attack['node'], 'messages')
                if time.perf_counter() > end:
                    break
                if attack['rate']:
                    time.sleep(1.0 / attack['rate'])

    _huge = _messages

    def _trajectories(self, attack: Attack) -> None:
        stage, goal = self.stage, np.array(self.stage.scene.goal)
        rng = np.random.default_rng(attack['seed'])
        message = stage.trajectory()
        message.points = []
        for k in range(attack['points']):
            there = goal + attack['far'] * rng.choice((-1.0, 1.0), len(goal)) * (k > 0)
            point = JointTrajectoryPoint(positions=there.tolist())
            point.time_from_start.sec, point.time_from_start.nanosec = divmod(
                10_000_000 * (k + 1), 1_000_000_000
            )
            message.points.append(point)
        end = time.perf_counter() + 2.0
        for _ in range(attack['count']):
            stage.references.publish(message)
            self._count('feedforward', 'messages')
            self._count('predictor', 'messages')
            if time.perf_counter() > end:
                break
            time.sleep(1.0 / attack['rate'])

    def _clock(self, attack: Attack) -> None:
        node, rng = attack['node'], adversary(attack['seed'], self.inventory, attack['node'])
        use = Parameter(
            name='use_sim_time',
            value=ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=True),
        )
        kind = 'rcl_interfaces/srv/SetParameters'
        self._ask(node, f'/{node}/set_parameters', kind, SetParameters.Request(parameters=[use]))
        publisher = self.stage.publisher('/clock', Clock)
        self.stage.witness.excuse_clock()
        for _ in range(attack['count']):
            publisher.publish(rng.message('rosgraph_msgs/Clock'))
            self._count(node, 'messages')
            time.sleep(0.01)

    def _topics(self, attack: Attack) -> None:
        rng = adversary(attack['seed'], self.inventory, attack['node'])
        for _ in range(attack['count']):
            kind = rng.one_of(STRANGE)
            topic = f'/strange/t{int(rng.rng.integers(TOPICS))}'
            try:
                publisher = self.stage.node.create_publisher(interface(kind), topic, 10)
            except RCLError:
                continue  # the stage itself still has it with another type
            time.sleep(0.06)
            publisher.publish(rng.message(kind.replace('/msg/', '/')))
            self._count('recorder', 'messages')
            time.sleep(0.02)
            self.stage.node.destroy_publisher(publisher)

    def _join(self, attack: Attack) -> None:
        """Let a participant join the domain and leave again."""
        context = Context()
        rclpy.init(args=[], context=context)
        node = Node('guest', context=context, use_global_arguments=False)
        time.sleep(0.1)
        node.destroy_node()
        rclpy.try_shutdown(context=context)
        self._count(attack['node'], 'joins')

    # ---- requests

    def _ask(self, node: str, service: str, kind: str, request: Any) -> Any:
        self._count(node, 'requests')
        reply = self.stage.ask(service, kind, request)
        if reply is None:
            self.unanswered.append((node, service))
        return reply

    def _requests(self, attack: Attack) -> None:
        node, service, kind = attack['node'], attack['service'], attack['type']
        rng = adversary(attack['seed'], self.inventory, node)
        changes = service.endswith('/change_state') and node == 'feedforward'
        begin = time.time_ns()
        for _ in range(attack['count']):
            self._ask(node, service, kind, rng.message('', interface(kind).Request))
            if node in self.asked:
                break
        if changes:
            self.stage.witness.excuse_anew(begin)

    def _transitions(self, attack: Attack) -> None:
        node, begin = attack['node'], time.time_ns()
        if node == 'feedforward':
            self.stage.witness.excuse_anew(begin)
        for number in attack['ids']:
            request = ChangeState.Request()
            request.transition.id = number
            kind = 'lifecycle_msgs/srv/ChangeState'
            self._count(node, 'transitions')
            if self.stage.ask(f'/{node}/change_state', kind, request) is None:
                self.unanswered.append((node, f'/{node}/change_state'))

    # ---- processes and files

    def _pause(self, attack: Attack) -> None:
        process = self.stage.process(attack['node'])
        for _ in range(attack['times']):
            begin = time.time_ns()
            process.send_signal(signal.SIGSTOP)
            time.sleep(attack['seconds'])
            process.send_signal(signal.SIGCONT)
            self._count(attack['node'], 'signals', 2)
            if attack['node'] == 'feedforward':
                self.stage.witness.excuse(begin, time.time_ns() + 10_000_000)
            time.sleep(0.02)

    def _end(self, attack: Attack) -> None:
        node = attack['node']
        process = self.stage.process(node)
        if node == 'feedforward':
            self.stage.witness.excuse_anew()
        time.sleep(attack['after'])
        self.asked.add(node)
        for name in attack['signals']:
            with suppress(ProcessLookupError):
                process.send_signal(getattr(signal, f'SIG{name}'))
            self._count(node, 'signals')
            time.sleep(attack['gap'])
        if not self.stage.comes(lambda: process.poll() is not None, END):
            self.stage.broken.append(f'{node}: must end within {END:g} s of {attack["signals"]}')
            self.stage.abort(node)

    def _cache(self, attack: Attack) -> None:
        """Damage some of the compiled kernels, then have a node start from them."""
        rng = np.random.default_rng(attack['seed'])
        files = kernel_files(self.stage.kernels)
        count = min(attack['count'], len(files))
        for place in rng.choice(len(files), count, replace=False):
            damage(files[int(place)], attack['what'], rng)
        self._count(attack['node'], 'files', count)
        self._end(attack)

    def _brake(self, attack: Attack) -> None:
        """Stop in the middle of a motion, perhaps ask for another one at once, then go back.

        A shaper's references must go on where the one before is: no joint jumps.
        """
        stage, node, goal = self.stage, attack['node'], self.stage.scene.goal
        told: list[Any] = []
        heard = stage.node.create_subscription(JointTrajectory, '/reference', told.append, 10)
        away = [each + STROKE for each in goal]
        stage.planned.publish(moving(stage, goal, away))
        self._count(node, 'messages')
        stage.comes(lambda: any(len(message.points) > 1 for message in told), STARTING)
        begin = time.perf_counter()
        stage.comes(lambda: time.perf_counter() - begin > attack['after'], STARTING)
        if attack['how'] == 'stop':
            self._ask(node, f'/{node}/stop', TRIGGER, Trigger.Request())
        else:
            stage.planned.publish(JointTrajectory(joint_names=list(stage.scene.joints)))
        if attack['again']:
            stage.planned.publish(moving(stage, away, goal))
        time.sleep(STOPPING)
        stage.node.destroy_subscription(heard)
        if node == 'shaper':
            for law in jumps(told):
                stage.broken.append(f'shaper: {law}')
            whole = [message for message in told if len(message.points) > 1]
            if whole:  # back from where it stands
                stage.planned.publish(moving(stage, whole[-1].points[-1].positions, goal))
                time.sleep(STOPPING)

    def _gauges(self, attack: Attack) -> None:
        """Let the gauges fail for a while; dead ones must not be fed back meanwhile."""
        stage, begin = self.stage, time.perf_counter()
        stage.gauges.fault = attack['what']
        self._count(attack['node'], 'messages', round(FEED * attack['seconds']))
        time.sleep(attack['seconds'])
        said = stage.status(FEEDBACK, begin + FALLEN_SILENT + NOTICED)[2]
        stage.gauges.fault = ''
        if stage.scene.feeds_back and attack['what'] in DEAD and said.get('active') == 'True':
            stage.broken.append(f'feedforward: must not feed dead gauges back, says {said}')

    def _rest(self, attack: Attack) -> None:
        """Attack nothing, and see that what adapts to the payload stays while the robot rests."""
        stage, swing = self.stage, self.stage.swing
        if swing is None:
            return

        def is_settled() -> bool:
            return swing.rested(time.time_ns()) > SETTLED

        stage.comes(is_settled, MOVES + RESTS)
        begin = time.perf_counter()
        stage.comes(lambda: not is_settled(), RESTS)
        stage.estimates.judge_rest(begin)

    def _kill(self, attack: Attack) -> None:
        """Kill a node, or a process that it has started."""
        node = attack['node']
        process = self.stage.process(node)
        self._count(node, 'signals')
        if not attack['child']:
            self.asked.add(node)
            self.killed.add(node)
            process.kill()
            process.wait()
            return
        for child in children(process.pid):
            with suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)

    def _halt(self, attack: Attack) -> None:
        """Stop the processes that a node has started, at any moment of theirs."""
        node = attack['node']
        halted = children(self.stage.process(node).pid)
        for child in halted:
            with suppress(ProcessLookupError):
                os.kill(child, signal.SIGSTOP)
        self._count(node, 'signals', len(halted))
        if attack['then'] == 'stop the node':
            kind = 'std_srvs/srv/Trigger'
            self._ask(node, f'/{node}/reset', kind, interface(kind).Request())
        time.sleep(attack['seconds'])
        last = signal.SIGKILL if attack['then'] == 'kill' else signal.SIGCONT
        for child in halted:
            with suppress(ProcessLookupError):
                os.kill(child, last)

    def _endless(self, attack: Attack) -> None:
        """Ask for a motion that takes hours or years, and perhaps for its stop."""
        stage = self.stage
        message = stage.trajectory(0.2)
        message.points[-1].time_from_start.sec = int(attack['seconds'])
        publisher = stage.publisher(
            stage.scene.plans_for, interface('trajectory_msgs/msg/JointTrajectory')
        )
        publisher.publish(message)
        self._count('shaper', 'messages')
        if attack['stop']:
            kind = 'std_srvs/srv/Trigger'
            self._ask('shaper', '/shaper/stop', kind, interface(kind).Request())

    def _description(self, attack: Attack) -> None:
        node, stage = attack['node'], self.stage
        rng = adversary(attack['seed'], self.inventory, node)
        stage.description.publish(String(data=self._bad_description(attack['what'], rng)))
        self._count(node, 'messages')
        time.sleep(0.05)
        if attack['anew'] and node == 'feedforward':
            self.stage.witness.excuse_anew()
        ids = (4, 2, 1) if attack['anew'] else ()
        for number in ids:  # deactivate, clean up, configure
            request = ChangeState.Request()
            request.transition.id = number
            self._count(node, 'transitions')
            self.stage.ask(f'/{node}/change_state', 'lifecycle_msgs/srv/ChangeState', request)
        if f'/{node}/reload_model' in self.inventory.services[node] and not ids:
            kind = 'std_srvs/srv/Trigger'
            self._ask(node, f'/{node}/reload_model', kind, Trigger.Request())

    def _bad_description(self, what: str, rng: Any) -> str:
        folder, good = self.stage.folder, self.stage.scene.urdf()
        if what == 'spoilt':
            place = int(rng.rng.integers(len(good)))
            more: str = rng.one_of(('', '<link', 'nan', '"', '-', '9' * 30, '</robot>', '&a;'))
            return good[:place] + more + good[place + int(rng.rng.integers(30)) :]
        if what == 'fifo':
            with suppress(FileExistsError):
                os.mkfifo(folder / 'fifo')
            return str(folder / 'fifo')
        if what == 'path':
            (folder / 'other.urdf').write_text(good)
            return str(folder / 'other.urdf')
        letters = rng.rng.integers(1, 0x2FF, 4000)
        said: dict[str, str] = {
            'bytes': ''.join(map(chr, letters)),
            'folder': str(folder),
            'bomb': BOMB,
            'huge': good.replace('<robot', f'<robot {" " * 9_000_000}', 1),
            'empty': '',
        }
        return said[what]

    def _socket(self, attack: Attack) -> None:
        address = self.stage.status('viewer: page')[2].get('address')
        if address is None:
            return
        rng = adversary(attack['seed'], self.inventory, 'viewer')
        sent = attack_page(address, rng, attack['count'])
        self._count('viewer', 'messages', sent)

    def _files(self, attack: Attack) -> None:
        """Spoil what the recorder writes to."""
        bags = sorted(self.stage.folder.glob(f'recordings_{self.stage.starts["recorder"]}/*'))
        bags = [bag for bag in bags if bag.is_dir()]
        if not bags:
            return
        folder = max(bags, key=lambda bag: bag.stat().st_mtime)
        files = sorted(folder.glob('*.mcap'))
        self._count('recorder', 'files')
        self.spoilt = attack['what'] != 'overwrite'  # no recorder reads what it has written
        if attack['what'] == 'folder' or not files:
            shutil.rmtree(folder, ignore_errors=True)
        elif attack['what'] == 'file':
            files[-1].unlink()
        elif attack['what'] == 'truncate':
            os.truncate(files[-1], files[-1].stat().st_size // 2)
        else:
            with files[-1].open('r+b') as file:
                file.write(b'\0' * 4096)


def moving(stage: SiegeStage, begin: Sequence[float], end: Sequence[float]) -> JointTrajectory:
    """Return a motion of a second from rest to rest."""
    message = stage.trajectory(LASTING)
    message.points[0].positions, message.points[1].positions = list(begin), list(end)
    return message


def jumps(told: Sequence[JointTrajectory]) -> list[str]:
    """Return where a trajectory does not go on as the one before does at its start."""
    found: list[str] = []
    before: tuple[float, SplineTrajectory] | None = None
    for message in told:
        if len(message.points) < 2:
            continue
        start = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        if not start:  # now: of somebody who says no time
            before = None
            continue
        rows = [(each.positions, each.velocities, each.accelerations) for each in message.points]
        times = np.array(
            [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in message.points]
        )
        q, qd, qdd = (np.array(each, dtype=float) for each in zip(*rows, strict=True))
        if before is not None:
            was = np.zeros((3, q.shape[1]))
            before[1].sample(start - before[0], *was)
            if (
                np.abs(was[0] - q[0]).max() > SAME_PLACE
                or np.abs(was[1] - qd[0]).max() > SAME_RATE
            ):
                found.append(
                    'a reference must go on where the one before is, got '
                    f'{q[0].tolist()} {qd[0].tolist()} after {was[0].tolist()} {was[1].tolist()}'
                )
        before = start, SplineTrajectory(times, q, qd, qdd)
    return found


def kernel_files(folder: Path) -> list[Path]:
    """Return the files of kernels that Python calls and that compile within seconds."""
    quick = [each for each in all_kernels() if each.py_func.__name__ not in HEAVY]
    names = {f'{each.py_func.__module__.rpartition(".")[2]}.{each.py_func.__qualname__}-'
             for each in quick}  # fmt: skip
    return [
        file for file in sorted(folder.rglob(f'*{SUFFIX}')) if file.name.startswith(tuple(names))
    ]


def damage(file: Path, what: str, rng: np.random.Generator) -> None:
    """Spoil a file as a full disk, a crash or a bad one does."""
    content = bytearray(file.read_bytes())
    if what == 'remove':
        file.unlink()
    elif what == 'garbage':
        file.write_bytes(rng.bytes(len(content)))
    elif what == 'flip':
        content[int(rng.integers(len(content)))] ^= 1 << int(rng.integers(8))
        file.write_bytes(content)
    else:
        file.write_bytes(content[: len(content) // 2] if what == 'truncate' else b'')


def children(pid: int) -> list[int]:
    """Return the processes that a process has started."""
    lists = Path(f'/proc/{pid}/task').glob('*/children')
    return [int(child) for each in lists for child in each.read_text().split()]


def lengthen(message: Any, one_of: Any, length: int) -> None:
    """Repeat one sequence of a message so often that it has so many elements."""
    places = [place for place in leaves(message) if SEQUENCE.match(place[2])]
    if not places:
        message.data = WORDS[-1] if hasattr(message, 'data') and message.data == '' else 0.0
        return
    owner, attribute, kind = one_of(places)
    values = list(getattr(owner, attribute)) or ['x' if 'string' in kind else 0.0]
    if 'double' in kind or 'string' in kind:
        setattr(owner, attribute, list(itertools.islice(itertools.cycle(values), length)))
    elif '/' in kind and getattr(owner, attribute):
        setattr(owner, attribute, values * (length // 30 // len(values)))
