"""A session of `denoc up`: its nodes, its phases, its clean end."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from denoc_ros.bags.reader import DESCRIPTION_TOPIC, SESSION_DESCRIPTION_TOPIC
from denoc_ros.cli.progress import Progress
from denoc_ros.cli.session.node_parameters import (
    changed_parameters,
    node_parameters,
    node_table,
    plant_numbers,
    write_parameters,
)
from denoc_ros.cli.session.phase_plans import Task, asked_at_pace, motion_of, with_plans
from denoc_ros.cli.session.processes import Health, ProcessError, Processes
from denoc_ros.cli.session.session_config import (
    AUTO,
    REAL,
    SIMULATED,
    Parameters,
    Phase,
    SessionConfig,
)
from denoc_ros.cli.session.session_file import SessionFile
from denoc_ros.cli.session.session_time import (
    FEEDFORWARD,
    RealTime,
    Rehearsal,
    SimulatedTime,
    choose,
    feedback_refusal,
    idle_seconds,
)
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.dynamics.state_rows import cores
from denoc_ros.parts import node_main, required
from denoc_ros.python_start import module_words
from denoc_ros.runtime.safety.stale_inputs import NO_JOINTS, STALE_JOINTS

if TYPE_CHECKING:  # an optional extra
    from denoc_ros.nodes.session_client import SessionClient

START_TIMEOUT = 300.0  # s until active: a slow and busy machine loads nodes for a minute
STARTING = 10.0  # s that nodes take on a machine which is neither slow nor busy
LEAD = 0.6  # s from publishing a reference to its start
FIRST_LEAD = 2.0  # s of the first one, which took 0.85 s to listeners that had just been found
MOST_PATIENCE = 16.0  # times the lead, on a machine that does not get ready in less
SETTLING = 0.1  # s until what was asked for has come about
HELD = 60.0  # s for which a robot waits at its start at most
TAIL = 0.2  # s a phase goes on behind its reference
STOP_ORDER = ('player', 'viewer', 'shaper', 'feedforward', 'predictor', 'plant', 'recorder')
START_ORDER = ('recorder', 'plant', 'predictor', 'feedforward', 'shaper', 'viewer')
RESETS: tuple[str, ...] = ('feedforward', 'shaper', 'plant', 'predictor')
LOOPS = ('plant', 'feedforward', 'predictor')  # that a rehearsal looks at
REHEARSING = 2.0  # s of the dearest motion
SHAPING = 2.0  # s from publishing to the start in which most plans are made
SHAPER = 'shaper: shaper'  # its status on /diagnostics
DECIDED = ('planned', 'refused', 'passed on')  # what a shaper counts of motions
PLANNING = 60.0  # s beyond `solve_timeout` in which it must have decided on a busy machine
DEAF = ('', NO_JOINTS, STALE_JOINTS)  # what a feedforward says of its torque
HEARING = 10.0  # s until a feedforward hears a plant that was started
WORDS = 2  # reports, one a second, between which a node looks around twice
GRAPH = 60.0  # s of wall time until a recorder has found all topics
REHEARSAL_FOLDER = 'rehearsal'  # where a recorder writes meanwhile: nobody reads it
REMOVAL_TIME_S = 30.0  # s until the middleware has forgotten a process that was killed
OTHER_ROBOT = (
    '/robot_description: description must be that of {}, got another robot from another node; '
    "the session's nodes have the configured one"
)
FIRST = 1.0  # s of simulated time before the first phase
DESIGNING = 60.0  # s until state feedback has gains: its process has to start
IDENTIFICATION = 'identification.run_numbers'
IDENTIFYING = 10.0  # s that numbers of a robot take
ENGAGING = 7.0  # s from gains for a motion until it trusts its estimate


def session_nodes(config: SessionConfig, bag: Path | None) -> list[str]:
    """Return the nodes that take part, in the order they start: no plant beside a bag."""
    left_out = set(config.without) if config.record else {*config.without, 'recorder'}
    if bag is not None:
        left_out.add('plant')
    return [name for name in START_ORDER if name not in left_out]


class Session:
    """Runs a task with nodes as processes.

    Parameters
    ----------
    file : SessionFile
        Where phases are noted. Its folder has `parameters/`; the recorder makes `bag/`.
    """

    def __init__(
        self,
        config: SessionConfig,
        task: Task,
        file: SessionFile,
        processes: Processes,
        client: SessionClient,
        progress: Progress,
    ) -> None:
        self._config = config
        self._task = task
        self._file = file
        self._folder = file.folder
        self._health = Health(processes, client)
        client.add_watch(self._health.check)
        client.add_watch(self._tell_other_robot)
        self._processes = processes
        self._client = client
        self._keep_time()
        self._progress = progress
        self._names = session_nodes(config, task.bag)
        self._parameters: dict[str, Parameters] = {}
        self._identified: Mapping[str, Any] = {}  # what session.json notes of the phase
        self._rehearses = False
        self._began = 0.0
        self._cpu_before: dict[str, float] = {}

    def run(self) -> None:
        """Start the nodes and run the phases; `end` must follow, whatever happens.

        Raises
        ------
        DenocError
            A node fails; what was recorded until then is good.
        """
        self._rehearses = self._config.time == AUTO
        self._begin()
        if self._rehearses:
            self._rehearse()
        self._began, self._cpu_before = time.perf_counter(), self._processes.cpu_seconds()
        for configured in self._config.phases:
            phase, identified = configured, dict[str, Any]()
            if configured.identify:
                phase, identified = self._improved(configured)
            if (changed := self._adapt(phase)) and self._time.is_simulated:
                # while time stands, nodes find sensors and other nodes
                self._client.until(self._spoken(changed), PLANNING)
            elif changed:
                self._await_feedforward()
            self._run_phase(phase, identified)
        if 'plant' in self._names:  # its last second counts as well
            self._client.until(self._spoken(['plant'], 1), HEARING)
            self._health.check_plant()

    def _begin(self, patience: float = 0.0) -> None:
        """Start all nodes, and wait until they hear each other.

        A busy machine may find the nodes of another session only now. Nodes of this one that were
        killed may be in the graph for a while, for which there is `patience` [s].
        """
        self._start(self._names, self._config.phases[0])
        uses_clock = self._config.time != REAL
        self._client.require_alone(self._names, uses_clock, own=1, patience=patience)
        if self._time.is_simulated:
            self._await_graph()
        else:
            self._await_feedforward()

    def _rehearse(self) -> None:
        """Choose the session's time by the cost of its dearest motion.

        The nodes run on where they run as they shall in the first phase, else they are started
        anew. Either way nothing of the rehearsal is left, neither in the bag nor of its motion.
        """
        phase = self._dearest()
        with self._progress.step('rehearsing', REHEARSING + SHAPING + self._engaging(phase)):
            if self._adapt(phase):
                self._await_feedforward()
            choice = choose(self._rehearsal(phase), self._feedback_refusal)
        self._progress.say(choice.why)
        self._file.note(time={**self._file.time, 'mode': choice.mode, 'why': choice.why})
        nodes = {name: dict(given) for name, given in self._config.nodes.items()}
        faster = [name for name, rate in choice.rates.items() if rate < self._rate(name)]
        for name in faster:
            nodes[name] = {**nodes.get(name, {}), 'update_rate': choice.rates[name]}
        self._config = replace(self._config, time=choice.mode, nodes=nodes)
        self._rehearses = False
        if choice.mode == REAL and not faster and phase is self._config.phases[0]:
            self._return_to_start()
            return
        with self._progress.step('ending the rehearsal'):
            for name in self._names:
                self._health.forget(name)
            self._processes.stop_all(STOP_ORDER)
        self._client.forget_nodes(self._names)
        self._keep_time()
        self._begin(REMOVAL_TIME_S)

    def _return_to_start(self) -> None:
        """Have nodes that have moved as they were started, and the recorder begin its bag."""
        first = self._config.phases[0]
        self._reset('shaper')  # it brakes a motion before it forgets it
        self._await_rest()
        for name in RESETS:
            self._reset(name)
        if self._knows_motion:
            # a reference that is still to come holds the robot where it begins
            self._publish(first, self._time.now() + HELD)
        self._time.pass_by(SETTLING)
        if 'recorder' in self._names:
            self._client.trigger('/recorder/stop')
        self._adapt(first)
        for name in RESETS[2:]:
            self._reset(name)
        if 'recorder' in self._names:
            self._client.trigger('/recorder/start')

    def _feedback_refusal(self, rate: float) -> str:
        """Why the feedforward's feedback cannot run at a lower rate [Hz], '' if it can."""
        given = self._config.nodes.get(FEEDFORWARD, {})
        if FEEDFORWARD not in self._names or 'update_rate' in given:
            return ''
        robot = load_robot(self._config.robot, gravity=self._config.gravity)
        return feedback_refusal(self._config, robot, min(rate, self._rate(FEEDFORWARD)))

    def _dearest(self) -> Phase:
        """Return the first phase with state feedback, the first of all if there is none."""
        config = self._config
        return next(filter(config.has_state_feedback, config.phases), config.phases[0])

    def _rehearsal(self, phase: Phase) -> Rehearsal:
        """Run a phase's motion for a while in real time, and measure."""
        if is_held := self._is_held_first(phase):
            self._hold_start(phase)
        _, start = self._prepare(phase, is_held)
        self._time.go_to(start)
        loops = [name for name in LOOPS if name in self._names]
        before = {name: self._deadlines(name) for name in loops}
        began, idle = time.perf_counter(), idle_seconds()
        used = sum(self._processes.cpu_seconds().values())
        self._time.pass_by(REHEARSING)
        elapsed = time.perf_counter() - began
        used = sum(self._processes.cpu_seconds().values()) - used
        after = {name: self._deadlines(name) for name in loops}
        met = {
            name: [b - a for a, b in zip(before[name], after[name], strict=True)] for name in loops
        }
        lost = self._client.diagnostics('recorder: recording').get('lost', '0')
        return Rehearsal(
            rates={name: self._rate(name) for name in loops},
            used=used / elapsed,
            idle=(idle_seconds() - idle) / elapsed,
            cores=cores(),
            late=max(missed / max(count, 1) for count, missed in met.values()),
            lost=int(lost),
            fixed=frozenset(n for n in loops if 'update_rate' in self._config.nodes.get(n, {})),
        )

    def _deadlines(self, name: str) -> tuple[int, int]:
        """Return how many deadlines a loop had, and how many it missed."""
        values = self._client.diagnostics(f'{name}: loop')
        ticks, late, skipped = (
            int(values.get(key, 0)) for key in ('ticks', 'overruns_total', 'skipped_total')
        )
        return ticks + skipped, late + skipped

    def _rate(self, name: str) -> float:
        return (
            node_table(name).settings(self._config.nodes.get(name, {}), name).number('update_rate')
        )

    def end(self) -> dict[str, float]:
        """End the nodes in order.

        Returns
        -------
        dict
            Share of a core that each has taken since the first phase began.
        """
        elapsed, after = time.perf_counter() - self._began, self._processes.cpu_seconds()
        self._processes.stop_all(STOP_ORDER)
        shutil.rmtree(self._folder / REHEARSAL_FOLDER, ignore_errors=True)
        if not self._began:
            return {}
        return {name: (after[name] - self._cpu_before.get(name, 0.0)) / elapsed for name in after}

    def _start(self, names: Sequence[str], phase: Phase) -> None:
        with self._progress.step(f'starting {", ".join(names)}', STARTING):
            for name in names:
                self._parameters[name] = self._wanted(name, phase)
                file = self._folder / 'parameters' / f'{name}.yaml'
                write_parameters(file, self._parameters[name])
                arguments = ['--ros-args', '--params-file', str(file)]
                if not self._parameters[name].get('urdf_path'):
                    arguments += ['--remap', f'{DESCRIPTION_TOPIC}:={SESSION_DESCRIPTION_TOPIC}']
                self._client.forget(name)
                self._processes.start(name, module_words(node_main(name), *arguments))
                self._health.watch(name)
            for name in names:
                self._client.wait_active(name, START_TIMEOUT)
        for name in names:
            page = self._client.diagnostics(f'{name}: page')
            for line in (f'open {page["address"]}', page['']) if page else ():
                self._progress.say(line)

    def _tell_other_robot(self) -> None:
        """Say once that others have another robot than the session's nodes."""
        if self._client.has_other_robot and not self._file.notes:
            self._file.add_note(OTHER_ROBOT.format(self._config.robot.name))
            self._progress.say(self._file.notes[-1])

    def _adapt(self, phase: Phase) -> list[str]:
        """Give the nodes the phase's parameters: live ones are set, others need a new start.

        Returns the nodes that have others.
        """
        anew, live = [], []
        for name in self._names:
            wanted, now = self._wanted(name, phase), self._parameters[name]
            changed = changed_parameters(name, now, wanted)
            if changed is None:
                anew.append(name)
            elif changed:
                self._client.set_parameters(name, changed)
                self._parameters[name] = wanted
                live.append(name)
        for name in anew:
            self._health.forget(name)
            self._processes.stop(name)
        if anew:
            self._start(anew, phase)
        return [*anew, *live]

    def _spoken(self, names: Sequence[str], words: int = WORDS) -> Callable[[], bool]:
        """Return a condition: nodes have reported so often from now on."""
        reports = self._client.reports
        wanted = {name: reports(name) + words for name in names}
        return lambda: all(reports(name) >= count for name, count in wanted.items())

    def _await_feedforward(self) -> None:
        """Wait, in real time, until the feedforward has all that its torque is made of."""
        self._await_hearing()
        self._await_gains()

    def _await_hearing(self) -> None:
        """Wait until the feedforward hears the plant: it has to discover one that was started."""
        if self._task.bag is not None or not {'feedforward', 'plant'} <= set(self._names):
            return
        client, before = self._client, self._client.reports('feedforward')

        def hears() -> bool:
            fresh = client.reports('feedforward') > before
            return fresh and client.diagnostics('feedforward: torque').get('', '') not in DEAF

        if not client.until(hears, HEARING):
            self._progress.say(f'feedforward: no joint_states of the plant within {HEARING:g} s')

    def _await_gains(self) -> None:
        """Wait for the first gains of state feedback: the process that makes them has to start."""
        client = self._client
        if self._parameters.get('feedforward', {}).get('feedback.state', 'off') == 'off':
            return
        before = client.reports('feedforward')

        def knows() -> bool:
            told = client.diagnostics('feedforward: state feedback')
            fresh = client.reports('feedforward') > before
            return fresh and (told.get('designs', '0') != '0' or bool(told.get('refused')))

        if not client.until(knows, DESIGNING):
            self._progress.say(f'feedforward: no gains of its feedback within {DESIGNING:g} s')

    def _is_held_first(self, phase: Phase) -> bool:
        """Whether the robot is held where a phase's motion starts until there are gains along it.

        Where time stands, it does so until they are there. A shaper's motion is not known yet.
        """
        feeds_back, real = self._config.has_state_feedback(phase), not self._time.is_simulated
        return feeds_back and real and self._knows_motion

    def _hold_start(self, phase: Phase) -> None:
        """Have the robot held where a phase's motion starts until there are gains along it.

        The machine may take longer for them than the motion for its start. Where the plant is put
        back, sensors seem to fail: the feedback begins anew behind that.
        """
        client = self._client
        for follows in ('plant', 'predictor'):
            taken = self._taken()
            self._reset(FEEDFORWARD)
            self._send(phase, self._time.now() + HELD + DESIGNING)
            self._time.pass_by(SETTLING)
            self._reset(follows)
        client.until(lambda: self._taken() > taken, HEARING)
        spoken = self._spoken([FEEDFORWARD])

        def knows() -> bool:
            told = client.diagnostics('feedforward: state feedback')
            return spoken() and told.get('designing') == 'False'

        if not client.until(knows, DESIGNING):
            self._progress.say(f'feedforward: no gains for the motion within {DESIGNING:g} s')

    def _await_graph(self) -> None:
        """Wait, while simulated time stands, until the recorder has found all topics."""
        client = self._client
        if self._task.trajectory is not None:
            client.await_listeners(len(self._listeners()))
        since: tuple[int, str | None] = (0, None)  # the first report that had the topics of now

        def found() -> bool:
            nonlocal since
            reports = client.reports('recorder')
            topics = client.diagnostics('recorder: recording').get('topics')
            if topics != since[1]:
                since = reports, topics
            return topics is not None and reports >= since[0] + 2

        spoken, records = self._spoken(self._names, WORDS + 1), 'recorder' in self._names
        client.until(lambda: (found() or not records) and spoken(), GRAPH)
        self._time.pass_by(FIRST)

    def _improved(self, phase: Phase) -> tuple[Phase, dict[str, Any]]:
        """Return a phase with the model and the plan that an earlier phase's recording gives it.

        Second is what session.json notes of it. The robot rests meanwhile.
        """
        finder = required(IDENTIFICATION, f'{self._config.path}: phases: {phase.name}: identify')
        for name in RESETS:
            self._reset(name)
        with self._progress.step(f'identifying the robot: {phase.identify}', IDENTIFYING):
            config = self._config
            robot = load_robot(config.robot, gravity=config.gravity)
            overrides = config.model_in(phase)
            known = robot.with_overrides(overrides) if overrides else robot
            found = finder.phase_numbers(self._closed_bag(), known, phase.identify, config.tip)
        self._progress.say('\n'.join(finder.number_lines(found)))
        model = {**overrides, **found.model.overrides}
        improved = replace(phase, model=model)
        planned = with_plans(config, robot, self._task, [improved], self._progress)
        self._task = planned.task
        noted = {'from': phase.identify, 'numbers': finder.noted_numbers(found)}
        return planned.phases[0], noted

    def _closed_bag(self) -> list[Path]:
        """Return the finished files of the bag, which have all that was recorded until now."""
        folder = self._folder / 'bag'
        before = len(list(folder.glob('*.mcap')))
        self._client.trigger('/recorder/split')
        if not self._client.until(lambda: len(list(folder.glob('*.mcap'))) > before, GRAPH):
            raise ProcessError(
                f'recorder: a new file of the bag must begin within {GRAPH:g} s, got none'
            )
        return sorted(folder.glob('*.mcap'), key=lambda file: file.stat().st_mtime_ns)[:-1]

    def _run_phase(self, phase: Phase, identified: Mapping[str, Any]) -> None:
        if is_held := self._is_held_first(phase):
            with self._progress.step(f'designing the feedback: {phase.name}'):
                self._hold_start(phase)
        self._identified = identified
        self._mark_begin(phase)
        self._health.moves = True
        if self._task.bag is not None:
            self._play(self._task.bag, phase)
        else:
            self._follow(phase, is_held)
        while self._health.stands():  # a phase is finished by nodes that go on
            self._client.wait(0.1)
        self._health.moves = False
        self._client.end_phase()
        self._file.end_phase(self._now_ns)

    @property
    def _knows_motion(self) -> bool:
        return self._task.trajectory is not None and 'shaper' not in self._names

    def _mark_begin(self, phase: Phase) -> None:
        self._client.begin_phase(phase.name)
        plant = plant_numbers(self._config, phase) if 'plant' in self._names else None
        self._file.begin_phase(
            phase.name,
            self._now_ns,
            model=self._config.model_in(phase) or None,
            plant=plant,
            identified=dict(self._identified) or None,
        )

    @property
    def _now_ns(self) -> int:
        return self._time.stamp_ns(self._time.now())

    def _follow(self, phase: Phase, is_held: bool) -> None:
        late, start = self._prepare(phase, is_held)
        puts_back = 'plant' in self._names and self._knows_motion and not is_held
        patience = 2.0
        while puts_back and late > 0.0 and patience <= MOST_PATIENCE:
            self._progress.say(
                f'{phase.name}: the plant was at its start {late:.1f} s after the motion had '
                f'begun: again, with {patience:g} times the lead'
            )
            self._mark_begin(phase)
            late, start = self._prepare(phase, is_held, patience)
            patience *= 2.0
        if puts_back and late > 0.0:
            raise ProcessError(
                f'plant: it must be at its start before the motion of {phase.name} begins, got it '
                f'{late:.1f} s late with a lead of {MOST_PATIENCE * LEAD:g} s: this machine needs '
                'time: simulated'
            )
        with self._progress.phase(phase.name, self._task.duration) as show:

            def watch(now: float) -> None:
                show(max(now - start, 0.0))
                self._health.check()

            self._time.go_to(start + self._task.duration, watch)
            show(self._task.duration)
        if self._task.trajectory is not None:
            self._await_rest()
        self._time.pass_by(TAIL)

    def _prepare(self, phase: Phase, is_held: bool, patience: float = 1.0) -> tuple[float, float]:
        """Reset the nodes and publish the reference, with so many times the usual lead.

        Returns by how much the nodes are late for its motion [s], and when the motion that is
        asked for starts [s].

        In real time the plant goes back when the feedforward already holds it where the reference
        starts, the predictor when the plant is there: it would take the way back for a motion.
        Where time stands, all of that is one moment. A robot held at the start is put back just
        before its feedback begins anew.
        """
        first, later = RESETS[:2], RESETS[2:]
        if self._time.is_simulated:
            first, later = RESETS, ()
        elif is_held:  # by feedback: at rest, as the new estimate begins by
            first, later = ('plant', *first), ('predictor',)
        for name in first:
            self._reset(name)
        if self._task.trajectory is not None:  # finding them may take longer than the lead
            self._client.await_listeners(len(self._listeners()))
        begin = start = self._time.now()
        if self._task.trajectory is not None:
            is_first = phase is self._config.phases[0] and not self._time.is_simulated
            lead = patience * LEAD + self._shaping + self._engaging(phase)
            begin = start + lead + (FIRST_LEAD - LEAD if is_first else 0.0)
            decided, taken = self._decided(), self._taken()
            start = self._publish(phase, begin)
            self._time.settle(lambda: self._taken() > taken, PLANNING)
            self._await_plan(decided)
            if is_first:  # held by torque alone a robot drifts: it goes back when the others do
                self._time.go_to(begin - lead)
            self._time.pass_by(SETTLING)
        for name in later:
            self._reset(name)
            self._time.pass_by(SETTLING)
        return self._time.now() - begin, start

    def _publish(self, phase: Phase, begin: float) -> float:
        """Publish a phase's motion from a moment [s]; return the start of the wanted motion."""
        trajectory, plan = self._task.trajectory, self._task.plans.get(phase.name)
        assert trajectory is not None
        begin_ns = self._send(phase, begin)
        if plan is None:
            return begin
        before, joints = -float(plan.t[0]), self._task.joints
        asked = asked_at_pace(trajectory, plan, joints)
        self._client.publish_asked(asked, joints, begin_ns + round(1e9 * before))
        return begin + before

    def _send(self, phase: Phase, begin: float) -> int:
        """Send a phase's motion to begin at a moment [s]; return its stamp [ns]."""
        motion, plan = self._task.trajectory, self._task.plans.get(phase.name)
        assert motion is not None
        joints, listeners = self._task.joints, len(self._listeners())
        self._client.await_listeners(listeners)
        if plan is not None:
            motion = motion_of(plan, joints)
        begin_ns = self._time.stamp_ns(begin)
        self._client.publish_reference(motion, joints, begin_ns, listeners)
        return begin_ns

    def _taken(self) -> int:
        """Return how many references or motions their first listener has taken."""
        first = 'shaper' if 'shaper' in self._names else 'feedforward'
        said = self._client.diagnostics(f'{first}: inputs')
        ends = ('reference accepted', 'input accepted')
        return sum(int(value) for key, value in said.items() if key.endswith(ends))

    def _decided(self) -> dict[str, int]:
        """Counts of the motions that the shaper planned, passed on and refused."""
        values = self._client.diagnostics(SHAPER)
        return {what: int(values.get(what, 0)) for what in DECIDED}

    def _await_plan(self, before: Mapping[str, int]) -> None:
        """Wait until the shaper has planned or refused a motion, however busy the machine is."""
        if 'shaper' not in self._names:
            return
        client = self._client
        patience = PLANNING + float(self._parameters['shaper'].get('solve_timeout', 0.0))
        end = time.perf_counter() + patience
        while (now := self._decided()) == before:
            if time.perf_counter() > end:
                said = client.diagnostics('shaper: inputs').get('', 'nothing')
                raise ProcessError(
                    f'shaper: node must plan the motion within {patience:g} s, got none; its '
                    f'inputs: {said}'
                )
            client.wait(0.05)
            self._health.check()
        if now['planned'] == before['planned']:
            self._progress.say(f'shaper: {client.diagnostics(SHAPER)[""]}')

    def _await_rest(self) -> None:
        """Let time pass until the shaper, if there is one, moves the robot no more."""
        while 'shaper' in self._names and self._shaper_does() == 'moving':
            self._time.pass_by(0.1)
            self._health.check()

    def _shaper_does(self) -> str | None:
        """State of the shaper; where time stands, by a report of that moment."""
        now_ns = self._now_ns
        self._time.settle(lambda: self._client.reported_ns('shaper') >= now_ns, PLANNING)
        return self._client.diagnostics(SHAPER).get('doing')

    @property
    def _shaping(self) -> float:
        """How long before the reference starts a shaper has it [s]."""
        return SHAPING if 'shaper' in self._names else 0.0

    def _engaging(self, phase: Phase) -> float:
        """How long the feedforward needs before a motion until its feedback acts [s]."""
        return ENGAGING if self._config.has_state_feedback(phase) else 0.0

    def _listeners(self) -> list[str]:
        """Return the nodes that must not miss a reference, or the motion it is made of."""
        first = 'shaper' if 'shaper' in self._names else 'feedforward'
        return [name for name in self._names if name in (first, 'recorder')]

    def _reset(self, name: str) -> None:
        if name in self._names:
            self._client.trigger(f'/{name}/reset')

    def _play(self, bag: Path, phase: Phase) -> None:
        words = module_words('denoc_ros.cli.player', str(bag), '--listeners', *self._listeners())
        self._processes.start('player', words, ends=True)
        with self._progress.phase(phase.name, self._task.duration) as show:
            start = time.perf_counter()
            while self._processes.running('player'):
                show(time.perf_counter() - start)
                self._client.wait(0.1)
                self._health.check()
        self._client.wait(TAIL)

    def _keep_time(self) -> None:
        """Have the time that the configuration says."""
        simulated = self._config.time == SIMULATED
        self._health.real_time = not simulated
        client, plant = self._client, 1.0 / self._rate('plant')
        self._time = SimulatedTime(client, plant) if simulated else RealTime(client)

    def _wanted(self, name: str, phase: Phase) -> Parameters:
        wanted = node_parameters(self._config, name, phase, self._folder)
        if name == 'recorder' and self._rehearses:
            wanted['output'] = str(self._folder / REHEARSAL_FOLDER)
        return wanted
