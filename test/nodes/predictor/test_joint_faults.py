"""The predictor with wrong joint states: no trace of what is refused, warnings for the rest."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from planar_chains import planar_chain
from predictor_bench import ARM, DOWN, RATE, begun, joint_state, swing
from rclpy.serialization import serialize_message

from denoc_ros.nodes.predictor import PredictorNode
from denoc_ros.runtime.inputs.input_monitor import InputError
from denoc_ros.runtime.loop.status import OK, WARN, Status
from denoc_ros.simulation.simulate import Run
from denoc_ros.types import Array

pytestmark = pytest.mark.ros
START_NS = 1_000_000_000_000
WRONG = 120  # row in the middle of the swing
Change = Callable[[Any, int], bool]  # changes a message of a row; False: it does not come


@pytest.fixture(scope='module')
def robot_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp('robot') / 'arm.urdf'
    file.write_text(planar_chain(ARM, 1, damping_ratio=0.02).replace('revolute', 'continuous'))
    return file


@pytest.fixture(scope='module')
def run(robot_file: Path) -> Run:
    return swing(robot_file)


class Estimate:
    """What a predictor makes of the run's joint states, row by row of simulated time."""

    def __init__(
        self, graph: Any, robot_file: Path, run: Run, change: Change, **parameters: Any
    ) -> None:
        given = {'urdf_path': str(robot_file), 'gravity': list(DOWN), 'update_rate': RATE}
        self.node = begun(graph.add(PredictorNode, start=False, **given, **parameters))
        self.deflection: Array = np.zeros(len(run.t))
        self.statuses: list[Status] = []
        self.restarts: list[Status] = []
        effort = parameters.get('source') == 'torque'
        for row, t in enumerate(run.t):
            message = joint_state(run, row, START_NS + round(1e9 * t), effort)
            if change(message, row):
                self._give(bytes(serialize_message(message)), float(t))
            self.node.tick(1 if row else 0)
            observer = self.node.observer
            tips, _ = observer.deflections.evaluate(observer.q, observer.qd)
            self.deflection[row] = tips[1]
            if row % 10 == 0:
                self.statuses.append(self.status)
                self.restarts.append(self._found('observer'))

    def _give(self, raw: bytes, now: float) -> None:
        try:
            self.node._on_joint_state(raw, now)
        except InputError as error:
            self.node.refuse(self.node.joint_input, error)

    @property
    def status(self) -> Status:
        """State of the joint states."""
        return self._found('joint states')

    def _found(self, name: str) -> Status:
        found: dict[str, Status] = {each.name: each for each in self.node.work_statuses()}
        return found[name]


def as_measured(_message: Any, _row: int) -> bool:
    return True


def without_velocity(message: Any, _row: int) -> bool:
    message.velocity = []
    return True


def missing(_message: Any, row: int) -> bool:
    return row != WRONG


@pytest.mark.parametrize(
    ('what', 'error', 'source'),
    [('position', 2.0, 'joints'), ('velocity', 50.0, 'joints'), ('effort', 1e4, 'torque')],
)
def test_a_refused_sample_leaves_no_trace(
    graph: Any, robot_file: Path, run: Run, what: str, error: float, source: str
) -> None:
    def wrong(message: Any, row: int) -> bool:
        if row == WRONG:
            getattr(message, what)[0] += error
        return True

    found = Estimate(graph, robot_file, run, wrong, source=source)
    expected = Estimate(graph, robot_file, run, missing, source=source)
    assert found.node.joint_input.rejected == {'implausible': 1}
    peak = np.abs(expected.deflection).max()
    np.testing.assert_allclose(found.deflection, expected.deflection, rtol=0, atol=1e-3 * peak)


def test_turns_of_continuous_joints_change_nothing(graph: Any, robot_file: Path, run: Run) -> None:
    def turned(message: Any, row: int) -> bool:
        message.position = [q + 2.0 * math.pi * (row // 7 % 3 - 1) for q in message.position]
        return without_velocity(message, row)

    found = Estimate(graph, robot_file, run, turned)
    expected = Estimate(graph, robot_file, run, without_velocity)
    assert not found.node.joint_input.rejected
    peak = np.abs(expected.deflection).max()
    np.testing.assert_allclose(found.deflection, expected.deflection, rtol=0, atol=1e-6 * peak)


@pytest.mark.parametrize('fault', ['degrees', 'sign', 'frozen'])
def test_velocities_that_contradict_positions_are_found_and_forgotten(
    graph: Any, robot_file: Path, run: Run, fault: str
) -> None:
    frozen: list[float] = []

    def wrong(message: Any, row: int) -> bool:
        if fault == 'frozen' and row >= WRONG:
            frozen[:] = frozen or message.velocity
            message.velocity = frozen
        elif fault != 'frozen':
            factor = math.degrees(1.0) if fault == 'degrees' else -1.0
            message.velocity = [factor * rate for rate in message.velocity]
        return True

    found = Estimate(graph, robot_file, run, wrong)
    expected = Estimate(graph, robot_file, run, without_velocity)
    levels = [each.level for each in found.statuses]
    since = 10 * levels.index(WARN)
    assert since <= (WRONG if fault == 'frozen' else 0) + round(0.4 * RATE)
    assert set(levels[since // 10 :]) == {WARN}
    assert 'velocities are derived from positions' in found.status.message
    peak = np.abs(expected.deflection).max()
    error = np.abs(found.deflection - expected.deflection)[since:] / peak
    assert error.max() < 0.01


def test_after_positions_jumped_the_warning_has_the_size_of_the_error(
    graph: Any, robot_file: Path, run: Run
) -> None:
    def offset(message: Any, _row: int) -> bool:
        message.position[0] += 1.0  # joint_2
        return True

    def jump(message: Any, row: int) -> bool:
        return row < WRONG or offset(message, row)

    found = Estimate(graph, robot_file, run, jump)
    expected = Estimate(graph, robot_file, run, offset)
    assert found.node.motion.status().values['restarts'] == 1
    warned = [k for k, each in enumerate(found.restarts) if 'expected_error_m' in each.values]
    assert 0 < 10 * warned[0] - WRONG <= round(0.2 * RATE)
    sizes = np.array([found.restarts[k].values['expected_error_m'] for k in warned])
    assert np.all(np.diff(sizes) < 0.0)
    errors = np.abs(found.deflection - expected.deflection)[10 * np.array(warned)]
    assert np.all(errors <= 1.5 * sizes)
    assert errors.max() > 0.3 * sizes.max()
    assert all(found.restarts[k].level == WARN for k in warned)
    assert {each.level for each in expected.statuses} == {OK}


def test_after_a_gap_the_warning_has_the_size_of_the_error(
    graph: Any, robot_file: Path, run: Run
) -> None:
    last = WRONG + round(0.4 * RATE)

    def gap(_message: Any, row: int) -> bool:
        return not WRONG <= row < last

    found = Estimate(graph, robot_file, run, gap)
    expected = Estimate(graph, robot_file, run, as_measured)
    warned = [k for k, each in enumerate(found.restarts) if 'expected_error_m' in each.values]
    assert 10 * warned[0] - last <= 10
    sizes = np.array([found.restarts[k].values['expected_error_m'] for k in warned])
    errors = np.abs(found.deflection - expected.deflection)[10 * np.array(warned)]
    assert np.all(errors <= 1.5 * sizes)
    assert errors.max() > 0.1 * sizes.max()


@pytest.mark.parametrize('factor', [1000.0, -1.0, 0.0])
def test_efforts_that_are_no_torques_are_found_and_forgotten(
    graph: Any, robot_file: Path, run: Run, factor: float
) -> None:
    def wrong(message: Any, row: int) -> bool:
        if row >= 60:
            message.effort = [factor * effort for effort in message.effort]
        return True

    found = Estimate(graph, robot_file, run, wrong, source='torque')
    expected = Estimate(graph, robot_file, run, as_measured)
    levels = [each.level for each in found.statuses]
    since = 10 * levels.index(WARN)
    assert 60 < since <= 60 + round(0.7 * RATE)
    assert 'effort must be the torque of the motion' in found.status.message
    peak = np.abs(expected.deflection).max()
    error = np.abs(found.deflection - expected.deflection)[since:] / peak
    assert error.max() < 0.01


@pytest.mark.parametrize('source', ['joints', 'torque'])
def test_good_joint_states_are_ok(graph: Any, robot_file: Path, run: Run, source: str) -> None:
    found = Estimate(graph, robot_file, run, as_measured, source=source)
    assert not found.node.joint_input.rejected
    assert {each.level for each in found.statuses} == {OK}


def test_a_reset_counts_before_the_next_message_also_where_the_loop_waits(
    graph: Any, robot_file: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = {'urdf_path': str(robot_file), 'gravity': list(DOWN), 'update_rate': RATE}
    node = begun(graph.add(PredictorNode, start=False, **given))

    def give(row: int, offset: float) -> None:
        message = joint_state(run, row, START_NS + round(1e9 * run.t[row]))
        message.position = [q + offset for q in message.position]
        node._on_joint_state(bytes(serialize_message(message)), float(run.t[row]))

    for row in range(10):
        give(row, 0.0)
    before = node.motion.position.copy()
    # Changes wait for the next tick.
    monkeypatch.setattr(PredictorNode, '_loop_runs', property(lambda _: True))
    node._reset()
    give(10, 1.0)
    assert not node.joint_input.rejected
    assert node.joint_input.accepted == 11
    np.testing.assert_allclose(node.motion.position, before + 1.0, atol=0.05)
