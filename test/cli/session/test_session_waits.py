"""A session waits for its nodes: for a shaper's plan and motion, for a plant to be heard."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import pytest

from denoc_ros.cli.progress import Progress
from denoc_ros.cli.session import session as sessions
from denoc_ros.cli.session import session_time
from denoc_ros.cli.session.phase_plans import Task
from denoc_ros.cli.session.processes import ProcessError, Processes
from denoc_ros.cli.session.session import Session
from denoc_ros.cli.session.session_config import load_config
from denoc_ros.cli.session.session_file import SessionFile
from denoc_ros.errors import DenocError
from denoc_ros.simulation.recorded.run_files import read_session
from denoc_ros.simulation.reference_motion import trajectory_from_config

if TYPE_CHECKING:
    from denoc_ros.nodes.session_client import SessionClient

ROOT = Path(__file__).resolve().parents[3]
JOINTS = ['joint_1', 'joint_2']
SESSION = f"""
robot: {ROOT}/config/robots/two_link_ff.urdf
gravity: [0, -9.81, 0]
time: real
reference: {{kind: points, times: [0, 0.05], positions: [[0.3, 0.6], [0.3, 0.6]]}}
duration: 0.05
nodes:
  shaper: {{method: zvd}}
  feedforward: false
  predictor: false
"""
FED_BACK = f"""
robot: {ROOT}/config/robots/canadarm_gauges.urdf
gravity: [0, 0, 0]
time: real
reference: {{kind: points, times: [0, 0.05], positions: [[0.2, 0.7, 0.5], [0.2, 0.7, 0.5]]}}
duration: 0.05
nodes: {{predictor: false, plant: {{update_rate: 250}}, feedforward: {{update_rate: 250}}}}
phases:
  - {{name: fed, feedforward: {{model: flexible, feedback: {{state: lqr}}}}}}
"""


class Clock:
    """Time that passes by waiting alone."""

    def __init__(self) -> None:
        self.now = 0.0

    def perf_counter(self) -> float:
        return self.now

    def time_ns(self) -> int:
        return round(1e9 * self.now)


class Client:
    """Stands for the graph: a shaper that plans late and moves long, as `tell` says."""

    def __init__(self, clock: Clock, tell: Callable[[float], dict[str, str]]) -> None:
        self._clock, self._tell = clock, tell
        self.published = self.starts = 0.0
        self.finding = 0.0  # s until the listeners are found
        self.putting_back: list[float] = []  # s that the plant takes for it, each time
        self.done: list[str] = []
        self.ended = 0.0
        self.has_other_robot = False
        self.others = ''  # nodes of another session, found late

    def diagnostics(self, status: str) -> dict[str, str]:
        if status == 'shaper: inputs':
            return {'': 'rejected: no such joint'}
        told = status in (
            'shaper: shaper', 'feedforward: torque', 'feedforward: state feedback'
        )  # fmt: skip
        return self._tell(self._clock.now) if told else {}

    def until(self, condition: Callable[[], bool], timeout: float) -> bool:
        end = self._clock.now + timeout
        while not condition() and self._clock.now < end:
            self._clock.now += 0.1
        return condition()

    def wait(self, seconds: float) -> None:
        self._clock.now += seconds

    def await_listeners(self, _: int) -> None:
        self._clock.now += self.finding
        self.finding = 0.0

    def publish_reference(self, _motion: Any, _joints: Any, start_ns: int, *_: Any) -> None:
        self.published, self.starts = self._clock.now, 1e-9 * start_ns
        self.done.append('reference')

    def trigger(self, service: str) -> None:
        self.done.append(service)
        if service == '/plant/reset' and self.putting_back:
            self._clock.now += self.putting_back.pop(0)

    def begin_phase(self, _: str) -> None:
        self.done.append('phase')

    def end_phase(self) -> None:
        self.ended = self._clock.now

    def forget_nodes(self, _names: Any) -> None: ...

    def require_alone(self, _names: Any, _uses_clock: bool, own: int = 0, **_: Any) -> None:
        if own and self.others:
            raise DenocError(self.others)

    def reports(self, _: str) -> int:
        return round(10.0 * self._clock.now)

    def failure(self, _: str) -> str:
        return ''

    def ignore(self, *_: Any) -> None: ...

    add_watch = forget = wait_active = ignore


class NoProcesses:
    """Stands for the nodes' processes."""

    def ignore(self, *_: Any) -> None: ...

    start = stop_all = ignore

    def cpu_seconds(self) -> dict[str, float]:
        return {}

    def activity(self, _: str) -> None: ...


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Client]:
    clock = Clock()
    for module in (sessions, session_time):
        monkeypatch.setattr(module, 'time', clock)
    (tmp_path / 'parameters').mkdir()

    def done(
        tell: Callable[[float], dict[str, str]],
        text: str = SESSION,
        joints: list[str] = JOINTS,
        finding: float = 0.0,
        putting_back: Sequence[float] = (),
        others: str = '',
    ) -> Client:
        file = tmp_path / 'session.yaml'
        file.write_text(text)
        config = load_config(file)
        task = Task(trajectory_from_config(config.reference, joints), joints, config.duration)
        client = Client(clock, tell)
        client.finding, client.putting_back = finding, list(putting_back)
        client.others = others
        processes = cast(Processes, NoProcesses())
        given = cast('SessionClient', client)
        notes = SessionFile(tmp_path, {})
        Session(config, task, notes, processes, given, Progress()).run()
        return client

    return done


def said(doing: str, planned: int = 0, refused: int = 0, message: str = 'ok') -> dict[str, str]:
    counts = {'planned': str(planned), 'refused': str(refused), 'passed on': '0'}
    return {'': message, 'doing': doing, **counts}


@pytest.mark.parts('planning')
def test_a_session_waits_for_a_late_plan_and_for_the_end_of_its_motion(run: Any) -> None:
    def tell(now: float) -> dict[str, str]:
        if now < 20.0:
            return said('planning' if now > 0.0 else 'waiting')
        return said('moving' if now < 30.0 else 'waiting', planned=1)

    client = run(tell)
    assert client.published < 1.0
    assert client.ended > 30.0


@pytest.mark.parts('planning')
def test_a_motion_that_is_refused_is_told(run: Any, capsys: pytest.CaptureFixture[str]) -> None:
    client = run(lambda now: said('waiting', refused=int(now > 0.5), message='not shaped: jerk'))
    assert client.ended < 5.0
    assert 'shaper: not shaped: jerk' in capsys.readouterr().err


@pytest.mark.parts('planning')
def test_a_motion_that_is_never_planned_ends_the_session(run: Any) -> None:
    with pytest.raises(ProcessError, match=r'plan the motion within 60 s, got none.*such joint'):
        run(lambda now: said('waiting'))


def test_a_reference_waits_until_the_feedforward_hears_the_plant(run: Any) -> None:
    """It was published at once: the feedforward began in the middle of the motion."""
    text = SESSION.replace('shaper: {method: zvd}', 'recorder: false')
    text = text.replace('feedforward: false', 'feedforward: {}')

    def tell(now: float) -> dict[str, str]:
        return {'': 'no reference yet' if now > 3.0 else 'no joint_states yet'}

    assert 3.0 < run(tell, text).published < 4.0
    deaf = run(lambda now: {'': 'stale joint_states'}, text)  # goes on, and says so
    assert deaf.published > sessions.HEARING


def test_a_motion_begins_after_its_listeners_are_found_however_late(run: Any) -> None:
    """In real time its beginning was over when it was published."""
    text = SESSION.replace('shaper: {method: zvd}', 'recorder: false')
    text = text.replace('feedforward: false', 'feedforward: {}')
    client = run(lambda _now: {'': 'no reference yet'}, text, finding=2.0)
    assert client.starts == pytest.approx(client.published + sessions.FIRST_LEAD)


def test_a_motion_that_begins_before_the_plant_is_back_begins_anew(
    run: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = SESSION.replace('shaper: {method: zvd}', 'recorder: false')
    text = text.replace('feedforward: false', 'feedforward: {}')
    client = run(lambda _now: {'': 'no reference yet'}, text, putting_back=[3.0, 3.0])
    again = ['phase', '/feedforward/reset', 'reference', '/plant/reset']
    assert client.done == 3 * again
    assert 'start 2.7 s after the motion had begun: again, with 2 times' in capsys.readouterr().err
    assert client.ended > client.starts
    (phase,) = read_session(tmp_path)['phases']
    assert phase['begin_ns'] > 6e9
    with pytest.raises(ProcessError, match=r'late with a lead of 9.6 s: this machine needs time'):
        run(lambda _now: {'': 'no reference yet'}, text, putting_back=5 * [20.0])


@pytest.mark.parts('planning')
def test_nothing_moves_beside_the_nodes_of_another_session(run: Any) -> None:
    with pytest.raises(DenocError, match='got /plant'):
        run(lambda now: said('waiting', planned=int(now > 1.0)), others='got /plant')


class DisputedClock:
    """Stands for a graph in which publishers of /clock tell times in turn."""

    def __init__(self, clock: Clock, times: Sequence[float], publishers: int) -> None:
        self._clock, self._times, self._publishers = clock, times, publishers
        self._turn = 0

    def clock_publishers(self) -> int:
        return self._publishers

    def clock_ns(self) -> int:
        self._turn += 1
        return round(1e9 * self._times[self._turn % len(self._times)])

    def wait(self, seconds: float) -> None:
        self._clock.now += seconds
        assert self._clock.now < 1000.0, 'the wait must end'

    def set_parameters(self, *_: Any) -> None: ...

    def reported(self, what: str) -> str:
        return f'feedforward: {what}: time stands'


@pytest.mark.parametrize(
    ('times', 'publishers', 'bound'),
    [
        ((0.0, 0.5), 2, session_time.DISPUTED_TIME_S),
        ((0.0, 5.0), 2, session_time.DISPUTED_TIME_S),  # a foreign time beyond the wait's end
        ((0.0, 0.5), 1, session_time.STANDS),  # one that goes to and fro
        ((0.5,), 1, session_time.STANDS),
    ],
)
def test_a_wait_ends_where_simulated_time_does_not_go_on(
    monkeypatch: pytest.MonkeyPatch, times: Sequence[float], publishers: int, bound: float
) -> None:
    clock = Clock()
    monkeypatch.setattr(session_time, 'time', clock)
    client = cast('SessionClient', DisputedClock(clock, times, publishers))
    rule = rf'must go on to 1\.000 s, got one .* of {publishers} publishers .*time stands'
    with pytest.raises(DenocError, match=rule):
        session_time.SimulatedTime(client, 0.01).go_to(1.0)
    assert bound < clock.now < 1.1 * bound


def test_a_wait_ends_at_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    monkeypatch.setattr(session_time, 'time', clock)
    times = [0.01 * k for k in range(101)]
    client = cast('SessionClient', DisputedClock(clock, times, 1))
    simulated = session_time.SimulatedTime(client, 0.01)
    simulated.go_to(1.0)
    assert simulated.now() == 1.0
    assert clock.now < session_time.DISPUTED_TIME_S


@pytest.mark.parts('feedback')
def test_a_motion_begins_when_its_feedback_has_gains(run: Any) -> None:
    def tell(now: float) -> dict[str, str]:
        return {'': 'ok', 'designs': '1', 'designing': str(now < 40.0)}

    client = run(tell, FED_BACK, ['joint_1', 'joint_2', 'joint_3'])
    assert 40.0 < client.published < 45.0
    again = ['/feedforward/reset', 'reference']
    begin = client.done.index('phase')
    # where the plant is put back, its sensors seem to fail: the feedback knows nothing of it
    assert client.done[:begin] == [*again, '/plant/reset', *again]
    # it moves by the noise of its feedback: it is put back just before the estimate begins anew
    assert client.done[begin:] == ['phase', '/plant/reset', *again]


@pytest.mark.parts('feedback')
def test_a_session_goes_on_without_gains(run: Any, capsys: pytest.CaptureFixture[str]) -> None:
    told = {'': 'ok', 'designs': '1', 'designing': 'True'}
    client = run(lambda _: told, FED_BACK, ['joint_1', 'joint_2', 'joint_3'])
    assert client.ended < 100.0
    assert 'no gains for the motion within 60 s' in capsys.readouterr().err
