"""The process that plans motions: its messages, and how it ends."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any, NoReturn

import numpy as np
import pytest
from child_processes import child, gone

from denoc_ros.errors import StateError
from denoc_ros.planning import plan_jobs
from denoc_ros.runtime.worker.worker import Answer, Planner
from denoc_ros.runtime.worker.worker_messages import LONGEST_HEADER, read_message, write_message
from denoc_ros.runtime.worker.worker_process import Worker, serve
from denoc_ros.trajectories import KNOTS, SplineTrajectory

pytestmark = pytest.mark.ros
ROBOT = {
    'source': 'config/robots/two_link_ff.urdf',
    'gravity': [0.0, 0.0, 0.0],
    'geometric_stiffness': True,
    'overrides': {},
}
SHAPE = {
    'job': 'shape',
    'robot': ROBOT,
    'method': 'zv',
    'tip': '',
    'joints': ['joint_1', 'joint_2'],
    'options': {},
    'limits': {},
    'servo': {},
}
PARENT = """
import sys, time
from denoc_ros.runtime.worker.worker import Planner
planner = Planner()
planner.start()
while planner.pid is None:
    time.sleep(0.001)
print(planner.pid, flush=True)
time.sleep(300.0)
"""


def motion() -> dict[str, np.ndarray]:
    knots = SplineTrajectory(np.array([0.0, 0.8]), np.array([[0.0, 0.0], [0.4, 0.3]])).knots()
    return {**dict(zip(KNOTS, knots, strict=True)), 'posture': np.zeros(6)}


def until(condition: Callable[[], object], timeout: float = 60.0) -> None:
    end = time.perf_counter() + timeout
    while not condition():
        assert time.perf_counter() < end, 'the condition did not come about in time'
        time.sleep(0.01)


def answered(planner: Planner) -> Answer:
    found: list[Answer] = []

    def look() -> bool:
        answer = planner.poll()
        found.extend([answer] if answer is not None else [])
        return bool(found)

    until(look)
    return found[0]


def test_messages_come_back_as_they_were_sent() -> None:
    stream = io.BytesIO()
    arrays = {'t': np.arange(3.0), 'q': np.ones((3, 2)), 'none': np.zeros((0, 2))}
    write_message(stream, {'id': 3, 'text': 'Zürich'}, arrays)
    whole = stream.getvalue()
    read = read_message(io.BytesIO(whole))
    assert read is not None
    assert read[0] == {'id': 3, 'text': 'Zürich'}
    for name, array in arrays.items():
        np.testing.assert_array_equal(read[1][name], array)
    for cut in (3, 20, len(whole) - 1):
        assert read_message(io.BytesIO(whole[:cut])) is None
    with pytest.raises(ValueError, match='a header must have at most'):
        read_message(io.BytesIO((LONGEST_HEADER + 1).to_bytes(8, 'little')))


def test_jobs_are_answered_in_order_and_bad_ones_say_why() -> None:
    jobs, answers = io.BytesIO(), io.BytesIO()
    posture = {'posture': np.zeros(6)}
    write_message(jobs, {**SHAPE, 'id': 1, 'job': 'load'}, posture)
    missing = {**ROBOT, 'source': 'no.urdf'}
    write_message(jobs, {**SHAPE, 'id': 2, 'job': 'load', 'robot': missing}, posture)
    write_message(jobs, {'id': 3, **SHAPE}, motion())
    write_message(jobs, {'id': 4, **SHAPE, 'method': 'zz'}, motion())
    write_message(jobs, {'id': 5, **SHAPE}, {})
    jobs.seek(0)
    serve(jobs, answers)
    answers.seek(0)
    found = []
    while (message := read_message(answers)) is not None:
        found.append(message)
    headers = [header for header, _ in found]
    assert [header['id'] for header in headers] == [1, 2, 3, 4, 5]
    assert headers[0]['joints'] == ['joint_1', 'joint_2']
    assert 'no.urdf' in headers[1]['error']
    assert headers[2]['delay'] > 0.2
    assert found[2][1]['q'].shape == (len(found[2][1]['t']), 2)
    assert 'method must be one of' in headers[3]['error']
    assert headers[4]['error'].startswith('KeyError')
    assert all(header['took'] >= 0.0 for header in headers)


def test_robot_is_loaded_once_for_many_jobs() -> None:
    planning = Worker()
    first = planning.robot(ROBOT)
    assert planning.robot(dict(ROBOT)) is first
    heavy = planning.robot({**ROBOT, 'overrides': {'payload.tool.mass': 2.0}})
    assert heavy is not first
    assert planning.robot(ROBOT) is first


def test_loading_plans_a_motion_that_stands_still(monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels of a method compiled within the first motion, which took too long for it."""
    plans: list[tuple[np.ndarray, str]] = []

    def shape(*arguments: Any, **_: Any) -> NoReturn:
        plans.append((arguments[2], arguments[3]))
        raise StateError('the tip must move')  # which is no failure of loading

    monkeypatch.setattr(plan_jobs, 'shape_motion', shape)
    posture = np.array([0.2, 0.0, 0.0, 0.3, 0.0, 0.0])
    header = {**SHAPE, 'job': 'load', 'method': 'tip', 'id': 1}
    answer, _ = Worker().answer(header, {'posture': posture})
    assert answer['joints'] == SHAPE['joints']
    ((q, method),) = plans
    assert method == 'tip'
    np.testing.assert_allclose(q, [[0.2, 0.3]] * len(q))


@pytest.mark.parametrize('count', [2, 4])
def test_the_points_between_are_waypoints_where_there_is_a_radius(
    monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    asked: dict[str, Any] = {}

    def shape(*_: Any, **options: Any) -> NoReturn:
        asked.update(options)
        raise StateError('planned')

    monkeypatch.setattr(plan_jobs, 'shape_motion', shape)
    rows = np.linspace([0.0, 0.0], [0.4, 0.2], count)
    knots = np.linspace(0.0, 1.0, count), rows, np.zeros_like(rows), np.zeros_like(rows)
    arrays = dict(zip(KNOTS, knots, strict=True), posture=np.zeros(6))
    job = {**SHAPE, 'method': 'rest_to_rest', 'options': {'radius': 0.05}, 'id': 1}
    assert Worker().answer(job, arrays)[0]['error'] == 'planned'
    assert asked['radius'] == (None if count == 2 else 0.05)
    np.testing.assert_allclose(asked.get('waypoints', np.zeros((0, 2))), rows[1:-1])


def test_process_answers_and_ends_with_its_input() -> None:
    planner = Planner()
    try:
        assert planner.start()
        number = planner.submit(SHAPE, motion(), 60.0)
        answer = answered(planner)
        assert (answer.job, answer.error) == (number, '')
        assert not planner.busy
        pid = planner.pid
        assert pid is not None
    finally:
        planner.close()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_no_process_is_left_by_a_parent_that_was_killed() -> None:
    with child([sys.executable, '-c', PARENT], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        planner = int(parent.stdout.readline())
        until(lambda: b'worker_process' in read_command(planner))
    until(lambda: not read_command(planner))


def read_command(pid: int) -> bytes:
    try:
        with open(f'/proc/{pid}/cmdline', 'rb') as file:
            return file.read()
    except OSError:
        return b''


def test_process_that_dies_at_once_is_not_started_all_the_time() -> None:
    planner = Planner()
    try:
        began = time.perf_counter()
        planner.start(began)
        until(lambda: planner.pid is not None)
        os.kill(planner.pid or 0, signal.SIGKILL)
        until(lambda: planner.poll() is None and not planner.running)
        assert planner.deaths == 1
        assert not planner.start(began + 0.9)  # within a second of the last start
        assert planner.start(began + 1.1)
        assert planner.starts == 2
    finally:
        planner.close()


@pytest.mark.parametrize('end', ['drop', 'close', 'late'])
@pytest.mark.parametrize('after', [0.0, 0.05, 0.3, 2.0])
def test_nobody_waits_for_a_process_that_is_stopped(after: float, end: str) -> None:
    """It is stopped while it starts, imports, or waits; its pipe is full then."""
    planner = Planner()
    try:
        planner.start()
        until(lambda: planner.pid is not None)
        pid = planner.pid
        assert pid is not None
        time.sleep(after)
        os.kill(pid, signal.SIGSTOP)
        began = time.perf_counter()
        planner.submit(SHAPE, {**motion(), 'much': np.zeros(1_000_000)}, 0.2)
        time.sleep(0.1)  # until the thread that writes is in the middle of it
        if end == 'drop':
            planner.drop()
        elif end == 'close':
            planner.close()
        else:
            answer = answered(planner)
            assert answer.error == 'planning must take at most 0.2 s, got longer'
        assert time.perf_counter() - began < 5.0  # 0.3 s, on a machine that is busy with others
        assert not planner.busy
        until(lambda: gone(pid))
    finally:
        planner.close()


STOPPING_PARENT = PARENT.replace(
    'time.sleep(300.0)',
    """planner.submit({'job': 'load', 'robot': {}}, {}, 60.0)
while planner.poll() is None:
    time.sleep(0.01)
import os, signal
os.kill(planner.pid, signal.SIGSTOP)
print('stopped', flush=True)
time.sleep(60.0)""",
)


@pytest.mark.skipif(sys.platform != 'linux', reason='as the kernel of Linux does it')
def test_a_stopped_process_ends_with_a_parent_that_was_killed() -> None:
    with child([sys.executable, '-c', STOPPING_PARENT], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        planner = int(parent.stdout.readline())
        assert parent.stdout.readline() == 'stopped\n'
    until(lambda: gone(planner))
