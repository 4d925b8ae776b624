"""Gains that another process designs: what comes back, what is void, what a dead process costs."""

from __future__ import annotations

import io
import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import denoc_ros as dn
from denoc_ros.feedback.feedback_design import PostureGains
from denoc_ros.feedback.feedback_settings import FeedbackSettings
from denoc_ros.feedback.gain_jobs import read_schedule
from denoc_ros.feedback.gain_worker import KEPT, FeedbackModel, GainWorker, WantedGains
from denoc_ros.feedback.state_feedback import StateFeedback
from denoc_ros.runtime.worker.worker_messages import read_message, write_message
from denoc_ros.runtime.worker.worker_process import serve
from denoc_ros.trajectories import SplineTrajectory

pytestmark = pytest.mark.ros  # as it waits for processes

ARM = Path(__file__).parents[2] / 'config/robots/canadarm_gauges.urdf'
HERE = np.array([0.2, 0.7, 0.5])
LONG = 300.0  # s, for a machine that is busy with others


def arm() -> FeedbackModel:
    robot = dn.load_robot(str(ARM), gravity=(0.0, 0.0, 0.0)).with_overrides(
        {'payload.tool.mass': 50.0}
    )
    source = {
        'source': robot.tree.source,
        'gravity': [0.0, 0.0, 0.0],
        'geometric_stiffness': True,
        'overrides': {'payload.tool.mass': 50.0},
    }
    settings = FeedbackSettings(1e-3, 'tool', 1.5e-3, velocity_noise=np.inf)
    joints = tuple(robot.joint_names)
    return FeedbackModel(robot, joints, np.full(3, 5000.0), np.zeros(robot.n), settings, source)


def motion() -> SplineTrajectory:
    return SplineTrajectory(np.array([0.0, 0.6]), np.array([HERE, HERE + 0.02]))


@pytest.fixture
def worker() -> Iterator[GainWorker]:
    worker = GainWorker()
    yield worker
    worker.close()


def born(worker: GainWorker) -> int:
    """Return the process once it is there."""
    end = time.perf_counter() + LONG
    while (pid := worker.planner.pid) is None:
        assert time.perf_counter() < end
        time.sleep(0.001)
    return pid


def made(worker: GainWorker) -> WantedGains:
    """Return the task of the next gains; there must be some."""
    end = time.perf_counter() + LONG
    while (found := worker.take()) is None:
        assert time.perf_counter() < end, 'the design must come to an end'
        time.sleep(0.005)
        worker.look()
    task, feedback = found
    assert feedback is not None, worker.refusal
    return task


@pytest.mark.parametrize('along', [True, False])
def test_gains_come_back_as_they_are_designed_here(along: bool) -> None:
    model = arm()
    job = model.job(HERE, motion() if along else None)
    header, arrays = job.message()
    jobs, answers = io.BytesIO(), io.BytesIO()
    write_message(jobs, {**header, 'robot': model.source, 'id': 1}, arrays)
    jobs.seek(0)
    serve(jobs, answers)
    answers.seek(0)
    message = read_message(answers)
    assert message is not None
    assert 'error' not in message[0]
    found, wanted = read_schedule(*message, job), job.schedule(model.robot)
    assert (len(found.times) > 1) is along
    np.testing.assert_array_equal(found.coordinates, wanted.coordinates)
    assert str(found.slowest) == str(wanted.slowest)
    assert found.settings == wanted.settings
    for one, other in zip(found.gains, wanted.gains, strict=True):
        for entry in fields(PostureGains):
            got, expected = getattr(one, entry.name), getattr(other, entry.name)
            # the spline is made again of its knots; rates that are not measured spread infinitely
            size = np.abs(expected[np.isfinite(expected)]).max(initial=0.0)
            np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-6 * size)


def test_a_newer_task_makes_an_older_one_void(worker: GainWorker) -> None:
    model = arm()
    first, second = WantedGains(model, HERE), WantedGains(model, HERE + 0.1)
    worker.begin(first)
    worker.begin(second)
    assert made(worker) is second
    assert worker.designs == 1
    assert not worker.busy


def test_a_motion_that_comes_again_has_its_gains_at_once(worker: GainWorker) -> None:
    model = arm()
    worker.begin(WantedGains(model, HERE, motion(), 5.0))
    made(worker)
    for k in range(KEPT):  # gains about a posture push none along a motion out
        worker.begin(WantedGains(model, HERE + 0.2 * k))
        made(worker)
    again = WantedGains(model, HERE, motion(), 60.0)
    worker.begin(again)
    found = worker.take()
    assert found is not None
    assert found[0] is again
    assert found[1] is not None
    assert found[1]._start == 60.0
    assert (worker.designs, worker.busy) == (1 + KEPT, False)
    # so has the last posture, and one near by
    near = WantedGains(model, HERE + 0.2 * (KEPT - 1) + 0.05)
    worker.begin(near)
    assert made(worker) is near
    assert (worker.designs, worker.busy) == (1 + KEPT, False)
    # another model, or another motion, has other gains
    worker.begin(WantedGains(arm(), HERE, motion(), 60.0))
    assert worker.take() is None
    other = SplineTrajectory(np.array([0.0, 0.6]), np.array([HERE, HERE + 0.01]))
    worker.begin(WantedGains(model, HERE, other, 60.0))
    assert worker.take() is None
    assert worker.busy


def test_a_motion_that_is_sent_again_meanwhile_gets_the_gains_in_work(worker: GainWorker) -> None:
    model = arm()
    tasks = [WantedGains(model, HERE, motion(), start) for start in (5.0, 6.0, 7.0)]
    for task in tasks:
        worker.begin(task)
    assert made(worker) is tasks[-1]
    assert (worker.designs, worker.busy) == (1, False)
    assert worker.planner._job == 1


def test_a_loop_takes_no_gains_before_they_are_whole(
    worker: GainWorker, monkeypatch: pytest.MonkeyPatch
) -> None:
    def slowly(*given: Any) -> StateFeedback:
        time.sleep(0.05)
        return StateFeedback(*given)

    monkeypatch.setattr('denoc_ros.feedback.gain_worker.StateFeedback', slowly)
    taken, ended = [], threading.Event()

    def loop() -> None:
        while not ended.is_set():
            if (found := worker.take()) is not None:
                taken.append(found)
            time.sleep(0.001)

    thread = threading.Thread(target=loop)
    thread.start()
    try:
        worker.begin(WantedGains(arm(), HERE))
        worker.await_design(LONG)
        time.sleep(0.05)
    finally:
        ended.set()
        thread.join()
    assert [feedback is not None for _, feedback in taken] == [True]


def test_a_process_that_dies_is_started_anew_for_what_it_was_asked(worker: GainWorker) -> None:
    task = WantedGains(arm(), HERE, motion(), 5.0)
    worker.begin(task)
    os.kill(born(worker), signal.SIGKILL)
    assert made(worker) is task
    assert (worker.planner.deaths, worker.designs) == (1, 1)


def test_a_process_that_dies_each_time_is_a_refusal(worker: GainWorker) -> None:
    worker.begin(WantedGains(arm(), HERE))
    end = time.perf_counter() + LONG
    while (found := worker.take()) is None:
        assert time.perf_counter() < end
        if worker.planner.pid is not None and worker.planner.busy:
            with suppress(ProcessLookupError):
                os.kill(worker.planner.pid, signal.SIGKILL)
        time.sleep(0.01)
        worker.look()
    assert found[1] is None
    assert 'the planner must answer, got its end' in worker.refusal


def test_a_design_that_is_waited_for_is_refused_with_its_cause(worker: GainWorker) -> None:
    model = arm()
    worker.begin(WantedGains(model, HERE))
    worker.await_design(LONG)
    assert worker.refusal == ''
    assert made(worker).model is model
    worker.begin(WantedGains(replace(model, limits=np.zeros(3)), HERE))
    worker.await_design(LONG)
    assert 'effort limits must be finite and > 0' in worker.refusal


def test_a_process_that_is_stopped_is_not_waited_for(worker: GainWorker) -> None:
    worker.begin(WantedGains(arm(), HERE))
    os.kill(born(worker), signal.SIGSTOP)
    began = time.perf_counter()
    worker.await_design(0.2)
    assert time.perf_counter() - began < 5.0
    assert worker.busy
    worker.close()
    assert time.perf_counter() - began < 5.0
