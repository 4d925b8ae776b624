"""After each step of a siege: are all nodes there, do they answer, and is all as before?

What was asked for (an end, a transition, another value) is taken back; whatever cannot be is a
broken law.
"""

from __future__ import annotations

import time
import urllib.request
from collections.abc import Callable
from typing import Any, ClassVar

from rcl_interfaces.msg import Parameter
from rcl_interfaces.srv import GetParameters, SetParameters
from std_srvs.srv import SetBool, Trigger
from trust.assault import Assault
from trust.attacks import Step
from trust.sieges.siege_gauges import FEEDBACK
from trust.sieges.siege_stage import FRESH, OUTPUTS, PATIENCE, RECOVERY, SiegeStage
from trust.stage import StageError

CONFIGURE, ACTIVATE = 1, 3
NEXT = {'unconfigured': CONFIGURE, 'inactive': ACTIVATE}  # transition towards active
NOTICED = 8.0  # s within which a recorder says that its file is gone
TRIGGER = 'std_srvs/srv/Trigger'


class Reminder:
    """Says when to ask a node again: each time later, as a busy machine takes its time.

    Asked for a reset every second, a node that needs two begins anew for ever.
    """

    def __init__(self, patience: float) -> None:
        self._patience, self._at = patience, time.perf_counter()  # s

    def due(self) -> bool:
        """Say whether it is time to ask."""
        now = time.perf_counter()
        if now - self._at <= self._patience:
            return False
        self._at, self._patience = now, 1.5 * self._patience
        return True


class Mending:
    """Brings the nodes of a stage back; each method returns or raises StageError: a broken law."""

    def __init__(self, stage: SiegeStage, assault: Assault) -> None:
        self.stage, self.assault = stage, assault
        self.inventory = assault.inventory
        self._reset = 0.0

    def mend(self, step: Step, tell: Callable[[str], None]) -> None:
        """Bring all nodes back after a step; tell of each law that is broken."""
        stage = self.stage
        touched = {attack['node'] for attack in step}
        does = {attack['do'] for attack in step}
        for node, service in self.assault.unanswered:
            if node not in self.assault.asked:
                tell(f'{node}: {service} must be answered')
        if 'description' in does:
            stage.say_description()
        for node in stage.scene.nodes:
            try:
                self._alive(node)
                self._active(node)
                if node in touched:
                    self._as_before(node, does)
            except StageError as error:
                tell(self._why(node, error))
                self._anew(node)
        for node, does_its_work in self._works.items():
            if node not in stage.scene.nodes:
                continue
            try:
                if node in touched or node in ('feedforward', 'predictor', 'plant'):
                    does_its_work(self)
            except StageError as error:
                tell(self._why(node, error))
                self._anew(node)
        to_recorder = [attack['do'] for attack in step if attack['node'] == 'recorder']
        if to_recorder == ['files'] and self.assault.spoilt:  # it was recording throughout
            self._noticed(tell)
        stage.witness.settle()

    def _why(self, node: str, error: StageError) -> str:
        """Return the broken law: that a process has ended is the reason for all else."""
        status = self.stage.process(node).poll()
        if status is None or 'status' in str(error):
            return str(error)
        return f'{node}: must not end, got status {status}\n{self.stage.words(node)}'

    # ---- there, and active

    def _alive(self, node: str) -> None:
        status = self.stage.process(node).poll()
        if status is None:
            return
        asked = node in self.assault.asked
        words = '' if asked and status == 0 else f'\n{self.stage.words(node)}'
        self.stage.witness.excuse_anew()
        self.stage.start(node)
        if node in self.stage.aborted:  # told already
            return
        if not asked:
            raise StageError(f'{node}: must not end, got status {status}{words}')
        if status != 0 and node not in self.assault.killed:
            raise StageError(f'{node}: must end with status 0, got {status}{words}')

    def _active(self, node: str) -> None:
        """Bring a node to its active state, from a final one by a new start."""
        stage = self.stage
        end = time.perf_counter() + PATIENCE
        while (state := stage.lifecycle(node, self._patience(node))) != 'active':
            if time.perf_counter() > end:
                raise StageError(f'{node}: must become active, is {state}')
            self._alive(node)
            if state == 'finalized':
                self._restart(node)
                end = time.perf_counter() + PATIENCE
            elif state in NEXT and not self._young(node):
                stage.say_description()
                stage.change(node, NEXT[state], PATIENCE)
            time.sleep(0.02)
        stage.up.add(node)

    def _young(self, node: str) -> bool:
        """Say whether a process is starting: it configures and activates itself."""
        return node not in self.stage.up

    def _patience(self, node: str) -> float:
        """Return within what time [s] a node answers: one that is starting may compile."""
        return PATIENCE if self._young(node) else RECOVERY

    def _restart(self, node: str) -> None:
        """End a process that has come to the end of its life cycle, and start it anew."""
        process = self.stage.process(node)
        process.terminate()
        if not self.stage.comes(lambda: process.poll() is not None, RECOVERY):
            process.kill()
            raise StageError(f'{node}: must end within {RECOVERY:g} s when finalized')
        if process.returncode:
            words = self.stage.words(node)
            raise StageError(f'{node}: must end with 0, got {process.returncode}\n{words}')
        self.stage.witness.excuse_anew()
        self.stage.start(node)

    def _anew(self, node: str) -> None:
        """After a broken law: a new process, so that the siege goes on."""
        stage = self.stage
        stage.witness.excuse_anew()
        stage.abort(node)
        stage.start(node)
        stage.comes(lambda: node in stage.node.get_node_names(), RECOVERY)
        try:
            self._active(node)
        except StageError as error:
            print(f'after a new start: {error}', flush=True)

    # ---- as before

    def _as_before(self, node: str, does: set[str]) -> None:
        stage = self.stage
        if does & {'requests', 'clock'}:
            self._set_back(node)
        if does & {'requests', 'description'}:
            if f'/{node}/reload_model' in self.inventory.services[node]:
                self._trigger(node, 'reload_model')
            if node == 'recorder':
                self._trigger(node, 'start')
        if node == 'feedforward' and does & {'requests', 'description', 'brake'}:
            request = SetBool.Request(data=True)
            stage.ask_again('/feedforward/enable', 'std_srvs/srv/SetBool', request)

    def _trigger(self, node: str, name: str) -> Any:
        return self.stage.ask_again(f'/{node}/{name}', TRIGGER, Trigger.Request())

    def _set_back(self, node: str) -> None:
        """Give all parameters the values that they had."""
        before, kind = self.inventory.parameters[node], 'rcl_interfaces/srv/'
        names = list(before)
        values = self.stage.ask_again(
            f'/{node}/get_parameters', f'{kind}GetParameters', GetParameters.Request(names=names)
        ).values
        changed = [
            Parameter(name=name, value=before[name])
            for name, value in zip(names, values, strict=False)
            if repr(value) != repr(before[name])  # NaN is itself here
        ]
        if not changed:
            return
        reply = self.stage.ask_again(
            f'/{node}/set_parameters',
            f'{kind}SetParameters',
            SetParameters.Request(parameters=changed),
        )
        if not all(result.successful for result in reply.results):
            print(f'{node}: not set back: {[r.reason for r in reply.results]}', flush=True)
            self._restart(node)
            self._active(node)

    # ---- does what it is for

    def _follows(self) -> None:
        stage, said_at = self.stage, 0.0
        shaped = 'shaper' in stage.scene.nodes
        reset = Reminder(10.0 if shaped else 1.0)  # plans take a while
        acts = self._feedback() if stage.scene.feeds_back else lambda: True

        def asked_again() -> bool:
            nonlocal said_at
            now = time.perf_counter()
            if stage.witness.following(stage.now_ns()) and acts():
                return True
            if now - said_at > 0.2:
                said_at = now
                stage.planned.publish(stage.trajectory())
            if reset.due():  # which a stamp from the future takes
                self._trigger('feedforward', 'reset')
                if shaped:
                    self._trigger('shaper', 'reset')
            return False

        try:
            self._wait('feedforward', asked_again, 'feedforward: must follow again')
        except StageError as error:
            said = [stage.status(f'feedforward: {what}')[1] for what in ('torque', 'inputs')]
            raise StageError(f'{error}, got {[*said, stage.status(FEEDBACK)]}') from None

    def _feedback(self) -> Callable[[], bool]:
        """Return what says whether the state feedback has acted since now.

        The joints that are fed in stand, whatever torque leaves. Feedback makes up for a force
        that seems to hold them, until its estimate is out of bounds: a fallback shows that it
        acted.
        """
        begin = time.perf_counter()
        fallbacks: set[str] = set()

        def acted() -> bool:
            said = self.stage.status(FEEDBACK, begin)[2]
            fallbacks.update({said['fallbacks']} if said else ())
            return said.get('active') == 'True' or len(fallbacks) > 1

        return acted

    def _shapes(self) -> None:
        """See that the shaper has its planner, and waits for a motion."""

        def waits() -> bool:
            said = self.stage.status('shaper: shaper', begin)[2]
            return said.get('doing') == 'waiting' and said.get('planner_pid') != 'none'

        begin = time.perf_counter()
        self._trigger('shaper', 'reset')
        self._wait('shaper', waits, 'shaper: must wait for a motion, with a planner')

    def _publishes(self, node: str) -> None:
        stage, reset = self.stage, Reminder(1.0)

        def heard() -> bool:
            now = time.perf_counter()
            if reset.due():
                self._trigger(node, 'reset')
            return now - stage.heard.get(node, 0.0) < FRESH

        try:
            self._wait(node, heard, f'{node}: must publish again')
        except StageError as error:
            known = stage.node.count_publishers(OUTPUTS[node])
            says = stage.status(f'{node}: loop', time.perf_counter() - RECOVERY)[:2]
            raise StageError(
                f'{error}; publishers that the stage knows: {known}; the node says {says}'
            ) from None

    def _records(self) -> None:
        begin = time.perf_counter()

        def written() -> bool:
            _, _, values = self.stage.status('recorder: recording', begin)
            return int(values.get('written', 0) or 0) > 0

        if self.stage.comes(written, NOTICED):
            return
        self._trigger('recorder', 'stop')
        self._trigger('recorder', 'start')
        self._wait('recorder', written, 'recorder: must record again')

    def _noticed(self, tell: Callable[[str], None]) -> None:
        """See that a recorder says that its file is gone or spoilt."""

        def said() -> bool:
            level, _, values = self.stage.status('recorder: recording')
            return level > 0 or int(values.get('lost', 0) or 0) > 0

        if not self.stage.comes(said, NOTICED):
            tell('recorder: must say on /diagnostics that its file is gone or spoilt')

    def _wait(self, node: str, condition: Callable[[], object], law: str) -> None:
        """Wait for what a node is to do; it may not end meanwhile."""
        process = self.stage.process(node)

        def comes() -> bool:
            return bool(condition()) or process.poll() is not None

        if not self.stage.comes(comes, self._patience(node)) or process.poll() is not None:
            raise StageError(law)

    def _shows(self) -> None:
        """See that the viewer serves its page."""

        def served() -> bool:
            address = self.stage.status('viewer: page')[2].get('address')
            if address is None:
                return False
            try:
                with urllib.request.urlopen(address, timeout=5.0) as page:
                    return bool(page.read(64))
            except OSError:
                return False

        self._wait('viewer', served, 'viewer: must serve its page again')

    _works: ClassVar[dict[str, Callable[[Mending], None]]] = {
        'feedforward': _follows,
        'predictor': lambda self: self._publishes('predictor'),
        'plant': lambda self: self._publishes('plant'),
        'recorder': _records,
        'viewer': _shows,
        'shaper': _shapes,
    }
