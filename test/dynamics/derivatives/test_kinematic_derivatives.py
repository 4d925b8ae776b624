"""Derivatives of frames, deflections and sensors against power series of the dense model."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles import Oracle
from strategies import law, random_state, robots, seeds

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import StateError
from denoc_ros.types import Array

Close = Callable[[Array, Array, float], None]
GRAVITY = (0.7, -1.3, -9.6)
ROUNDING = 1e-9  # of columns that are differentiated twice, over a chain of six bodies


class FrameOracle(Oracle):
    """Frames of the dense model with the derivatives of their motion by q and q'."""

    def motion(self, frame: str, q: Array, qd: Array, qdd: Array) -> tuple[Array, Array]:
        """Twist and acceleration (2, 6), and their derivatives (2, 6, 2 n) by q and q'."""
        series = self._series(q, qd, qdd)
        pose = self._attached(self.tree.frames[frame], series, self.poses(series))
        R, Rd, Rdd = pose[:3, :3].c * np.array([1, 1, 2])[:, None, None, None]
        p = pose[:3, 3].c
        turning = _product(Rd, R)  # R' R^T, to first order in the directions
        growing = _product(Rdd, R) + _product(Rd, Rd)
        twist = np.concatenate([p[1], _axial(turning)], axis=1)
        acceleration = np.concatenate([2 * p[2], _axial(growing)], axis=1)
        both = np.stack([twist, acceleration], axis=1)
        return both[0], np.moveaxis(both[1:], 0, -1)


def _product(a: Array, b: Array) -> Array:
    """A B^T of first-order series (1 + directions, 3, 3)."""
    bt = np.swapaxes(b, -1, -2)
    c = a[:1] @ bt + a @ bt[:1]
    c[0] = a[0] @ bt[0]
    return np.asarray(c)


def _axial(w: Array) -> Array:
    return np.stack([w[:, 2, 1], w[:, 0, 2], w[:, 1, 0]], axis=1)


def near(value: Array, expected: Array) -> None:
    """Equal to rounding of motions of the order of 1, whose parts may cancel."""
    scale = max(1.0, float(np.abs(expected).max(initial=0.0)))
    np.testing.assert_allclose(value, expected, rtol=0, atol=ROUNDING * scale)


@law(10)
@given(text=robots(), seed=seeds, geometric=st.booleans())
def test_frames_move_and_change_as_their_series_say(text: str, seed: int, geometric: bool) -> None:
    robot = load_robot(text, gravity=GRAVITY, geometric_stiffness=geometric)
    oracle = FrameOracle(robot.tree, GRAVITY, geometric)
    s, n = random_state(robot.coordinate_names, seed), robot.n
    for frame in robot.tree.frames:
        motion, by = oracle.motion(frame, s.q, s.qd, s.qdd)
        near(robot.frame_motion(frame, s.q, s.qd, s.qdd), motion)
        jacobian = oracle.frame_jacobian(frame, s.q)
        velocity = robot.frame_velocity_derivatives(frame, s.q, s.qd)
        near(np.concatenate(velocity, axis=1), by[0])
        acceleration = robot.frame_acceleration_derivatives(frame, s.q, s.qd, s.qdd)
        near(np.concatenate(acceleration[:2], axis=1), by[1])
        near(acceleration[2], jacobian)
        rate = robot.frame_jacobian_rate(frame, s.q, s.qd)
        near(rate[:3], by[0, :3, :n])
        near(rate @ s.qd, motion[1] - jacobian @ s.qdd)


@law(10)
@given(text=robots(), seed=seeds)
def test_deflections_change_as_their_series_say(close: Close, text: str, seed: int) -> None:
    robot = load_robot(text, gravity=GRAVITY)
    oracle, n = Oracle(robot.tree, GRAVITY), robot.n
    s = random_state(robot.coordinate_names, seed)
    for i, body in enumerate(robot.tree.bodies):
        if body.beam is None or not any(body.beam.modes):
            continue
        station = 0.37 * body.beam.length
        series = oracle._series(s.q, s.qd, s.qdd)
        line = oracle._centre_line(i, series, np.array([station])).c[..., 0]
        close(robot.tip_deflection_jacobian(body.name, s.q, station), line[0, 1 : 1 + n].T, 1e-10)
        rate = robot.tip_deflection_jacobian_rate(body.name, s.qd, station)
        close(rate, line[1, 1 : 1 + n].T, 1e-10)


def rig(repository: Path) -> Robot:
    return load_robot(repository / 'config/robots/ssrms.urdf')


@pytest.mark.usefixtures('two_threads')
def test_rows_and_outputs_are_those_of_single_states(repository: Path) -> None:
    robot = rig(repository)
    n, frame = robot.n, list(robot.tree.frames)[-1]
    q, qd, qdd = np.random.default_rng(3).uniform(-0.3, 0.3, (3, 130, n))
    shapes = {
        'frame_motion': (2, 6),
        'frame_jacobian_rate': (6, n),
        'frame_velocity_derivatives': (2, 6, n),
        'frame_acceleration_derivatives': (3, 6, n),
    }
    states = {'frame_motion': (q, qd, qdd), 'frame_acceleration_derivatives': (q, qd, qdd)}
    for name, shape in shapes.items():
        verb, given_states = getattr(robot, name), states.get(name, (q, qd))
        out = np.full((130, *shape), np.nan)
        verb(frame, *given_states, out=out)
        for k in (0, 64, 129):
            single = np.full(shape, np.nan)
            verb(frame, *(x[k] for x in given_states), out=single)
            # to rounding: a compiler may build the loop over rows with other instructions
            np.testing.assert_allclose(out[k], single, rtol=0, atol=1e-14, err_msg=name)
    link = next(body.name for body in robot.tree.bodies if body.beam is not None)
    row = robot.tip_deflection_jacobian(link, q)[7]
    np.testing.assert_allclose(row, robot.tip_deflection_jacobian(link, q[7]), rtol=1e-14)
    # one state among rows stands for all of them
    np.testing.assert_allclose(
        robot.frame_jacobian_rate(frame, q, qd[0])[5],
        robot.frame_jacobian_rate(frame, q[5], qd[0]),
        rtol=0,
        atol=1e-14,
    )


def test_sensors_change_by_their_rows(repository: Path) -> None:
    robot = load_robot(repository / 'config/robots/canadarm_gauges.urdf')
    assert robot.tree.sensors
    q = np.random.default_rng(1).uniform(-0.1, 0.1, robot.n)
    by_q, by_qd, by_qdd = robot.sensor_derivatives(q)
    step = np.random.default_rng(2).uniform(-0.1, 0.1, robot.n)
    change = robot.sensor_values(q + step) - robot.sensor_values(q)
    np.testing.assert_allclose(by_q @ step, change, rtol=1e-10, atol=1e-12 * abs(change).max())
    assert not by_qd.any()
    assert not by_qdd.any()
    assert robot.sensor_derivatives(np.tile(q, (3, 1)))[0].shape == (3, *by_q.shape)


def test_wrong_states_are_refused(repository: Path) -> None:
    robot = rig(repository)
    q = np.zeros(robot.n)
    with pytest.raises(StateError, match='frame must be one of'):
        robot.frame_motion('nothing', q, q)
    with pytest.raises(StateError, match='qd must be finite'):
        robot.frame_motion('tool', q, np.full(robot.n, np.nan))
    with pytest.raises(StateError, match='out must be'):
        robot.frame_jacobian_rate('tool', q, q, out=np.zeros((3, robot.n)))
