"""What changes while a robot runs: its payload, without compiling or rebuilding; and gravity."""

from __future__ import annotations

import pickle
from collections.abc import Callable

import numpy as np
from hypothesis import given
from scipy.spatial.transform import Rotation
from strategies import law, random_state, robots, seeded_robot, seeds

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.kernels.jit.compiled import DECLARED
from denoc_ros.types import Array

Close = Callable[[Array, Array, float], None]


def signatures() -> dict[str, int]:
    return {kernel.__name__: len(kernel.signatures) for kernel in DECLARED}


def test_payload_changes_at_run_time_without_compiling_or_rebuilding(close: Close) -> None:
    robot = load_robot(seeded_robot(6))
    frame = list(robot.tree.frames)[-1]
    stepper = Stepper(robot, 1e-3)
    s = random_state(robot.coordinate_names, 1)
    before = robot.inverse_dynamics(s.q, s.qd, s.qdd)
    q, qd = s.q.copy(), s.qd.copy()
    stepper.free(q, qd, before)
    compiled, handle, model = signatures(), robot.handle, robot.constants
    for payload in (
        (2.0, (0.0, 0.0, 0.0), None),
        (2.0, (0.1, -0.2, 0.3), None),
        (2.0, (0.1, -0.2, 0.3), np.diag([0.2, 0.3, 0.4])),
    ):
        robot.set_payload(frame, *payload)
        after = robot.inverse_dynamics(s.q, s.qd, s.qdd)
        assert np.max(np.abs(after - before)) > 1e-6  # mass, centre and inertia count each
        before = after
        close(robot.inertia_matrix(s.q) @ s.qdd + robot.bias_forces(s.q, s.qd), after, 1e-12)
        stepper.free(q, qd, after)
    assert signatures() == compiled
    assert robot.handle is handle
    assert robot.constants is model


def test_a_scaled_load_stays_scaled(close: Close) -> None:
    """Whatever is changed after it, in whatever order, and in copies."""
    robot = load_robot(seeded_robot(6))
    frame, payload = list(robot.tree.frames)[-1], (2.0, (0.1, -0.2, 0.3))
    s = random_state(robot.coordinate_names, 5)
    loaded = robot.copy()
    loaded.set_payload(frame, *payload)
    wanted = loaded.with_scaled_load(frame, 1.5)
    late = robot.with_scaled_load(frame, 0.5).with_scaled_load(frame, 3.0)
    late.set_payload(frame, *payload)
    in_two = loaded.with_scaled_load(frame, 3.0).copy().with_scaled_load(frame, 0.5)
    for found in (late, in_two, pickle.loads(pickle.dumps(wanted))):
        close(found.inertia_matrix(s.q), wanted.inertia_matrix(s.q), 1e-13)
    assert np.abs(wanted.inertia_matrix(s.q) - loaded.inertia_matrix(s.q)).max() > 1e-6
    # of a number beside the inertia, and of one for which the model is built anew
    for change in ({f'joint.{robot.joint_names[0]}.damping': 0.7}, {f'payload.{frame}.mass': 1.0}):
        found = wanted.with_overrides(change)
        after = loaded.with_overrides(change).with_scaled_load(frame, 1.5)
        close(found.inertia_matrix(s.q), after.inertia_matrix(s.q), 1e-13)


def test_stepper_follows_the_payload_of_its_robot() -> None:
    text = seeded_robot(6)
    robot, loaded = load_robot(text), load_robot(text)
    frame = list(robot.tree.frames)[-1]
    stepper = Stepper(robot, 1e-3)
    for each in (robot, loaded):
        each.set_payload(frame, 3.0, (0.1, 0.0, 0.0))
    s = random_state(robot.coordinate_names, 2)
    ends = []
    for one in (stepper, Stepper(loaded, 1e-3)):
        q, qd = s.q.copy(), s.qd.copy()
        one.free(q, qd, np.zeros(robot.n))
        ends.append((q, qd))
    np.testing.assert_array_equal(ends[0], ends[1])


def tilted(text: str, angles: Array) -> str:
    """The robot on a ground that is turned: a new root under the old one."""
    turn = ' '.join(repr(float(angle)) for angle in angles)
    ground = (
        f'<link name="ground"/><joint name="tilt" type="fixed"><parent link="ground"/>'
        f'<child link="base"/><origin rpy="{turn}"/></joint></robot>'
    )
    return text.replace('</robot>', ground)


@law(12)
@given(text=robots(most=4), seed=seeds)
def test_base_and_gravity_turned_together_change_nothing(
    close: Close, text: str, seed: int
) -> None:
    random = np.random.default_rng(seed)
    gravity, angles = random.normal(0.0, 9.81, 3), random.uniform(-3.0, 3.0, 3)
    turn = Rotation.from_euler('xyz', angles)  # URDF's fixed axes
    upright = load_robot(text, gravity=gravity)
    turned = load_robot(tilted(text, angles), gravity=turn.apply(gravity))
    s = random_state(upright.coordinate_names, seed)

    def results(robot: Robot) -> list[Array]:
        return [
            robot.inverse_dynamics(s.q, s.qd, s.qdd),
            robot.forward_dynamics(s.q, s.qd, s.qdd),
            robot.inertia_matrix(s.q),
            robot.energy(s.q, s.qd),
        ]

    names = ('inverse', 'forward', 'inertia', 'energy')
    assert turned.coordinate_names == upright.coordinate_names
    for name, value, expected in zip(names, results(turned), results(upright), strict=True):
        # accelerations carry the inertia's condition number
        close(value, expected, 1e-8 if name == 'forward' else 1e-11)


def test_gravity_at_any_angle_weighs_alike() -> None:
    text = seeded_robot(4)
    zero = load_robot(text, gravity=(0.0, 0.0, 0.0))
    s = random_state(zero.coordinate_names, 3)
    weightless = zero.bias_forces(s.q, s.qd)
    axes = [
        load_robot(text, gravity=9.81 * axis).bias_forces(s.q, s.qd) - weightless
        for axis in np.eye(3)
    ]
    direction = np.array([0.36, -0.48, 0.8])
    tilted_load = load_robot(text, gravity=9.81 * direction).bias_forces(s.q, s.qd) - weightless
    np.testing.assert_allclose(
        tilted_load, direction @ np.array(axes), rtol=0.0, atol=1e-10 * np.max(np.abs(axes))
    )
