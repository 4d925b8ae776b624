"""Floating bases, in the rigid limit, against Pinocchio's free-flyer on the same file."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from base_robots import description, floating, root_of, spacecraft
from test_rigid_limit_pinocchio import EXAMPLES, Peer, close, identity, read, without_dynamics

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.dynamics.rotations import left_jacobians
from denoc_ros.types import Array

# the recursions differ by rounding; states of 1 rad and 1 m, up to 118 coordinates
RELATIVE = 1e-10


class State(NamedTuple):
    """One motion in our coordinates and in Pinocchio's (base twist in the base's own axes)."""

    q: Array
    qd: Array
    qdd: Array
    place: Array
    rate: Array
    up: Array
    turn: Array  # (n, n): their rates from ours


def peer_of(text: str, names: list[str]) -> Peer:
    model = pin.buildModelFromXML(text, pin.JointModelFreeFlyer())
    order = [model.joints[model.getJointId(name)].idx_v for name in names]
    return Peer(model, np.array([0, 1, 2, 3, 4, 5, *order], dtype=int))


def state_of(robot: Robot, peer: Peer, root: str, seed: int) -> State:
    rng = np.random.default_rng(seed)
    q, qd, up = rng.uniform(-1.0, 1.0, (3, robot.n))
    q[3:6] *= 2.0
    pose = robot.frame_pose(root, q)
    place = peer.configuration(list(robot.joint_names), q[6:])
    place[:3] = pose[:3, 3]
    place[3:7] = pin.Quaternion(pose[:3, :3]).coeffs()
    back = pose[:3, :3].T
    turn = np.eye(robot.n)
    turn[:3, :3], turn[3:6, 3:6] = back, back @ left_jacobians(q[3:6])
    rate = turn @ qd
    # the base's acceleration at q'' = 0: theirs is that of the components v, in turning axes
    bias = robot.frame_motion(root, q, qd)[1]
    drift = np.zeros(robot.n)
    drift[:3] = back @ bias[:3] - np.cross(rate[3:6], rate[:3])
    drift[3:6] = back @ bias[3:]
    return State(q, qd, up, place, peer.spread(rate), peer.spread(turn @ up + drift), turn)


def compare(text: str, inertial: str, seed: int) -> None:
    robot = load_robot(floating(text, inertial))
    root = root_of(text)
    if inertial:
        text = re.sub(rf'<link name="{root}"\s*/>', f'<link name="{root}">{inertial}</link>', text)
    peer = peer_of(text, list(robot.joint_names))
    data = peer.model.createData()
    state = state_of(robot, peer, root, seed)
    q, qd, qdd, turn, order = state.q, state.qd, state.qdd, state.turn, peer.order
    tau = pin.rnea(peer.model, data, state.place, state.rate, state.up)[order]
    mine = robot.inverse_dynamics(q, qd, qdd)
    close(mine, turn.T @ tau, RELATIVE)
    upper = np.triu(pin.crba(peer.model, data, state.place))
    full = turn.T @ (upper + np.triu(upper, 1).T)[np.ix_(order, order)] @ turn
    close(robot.inertia_matrix(q), full, RELATIVE)
    pin.computeCentroidalMomentum(peer.model, data, state.place, state.rate)
    centre = data.com[0]
    moment = data.hg.angular + np.cross(centre, data.hg.linear)
    close(robot.momentum(q, qd), np.append(data.hg.linear, moment), RELATIVE)
    close(robot.centre_of_mass(q), centre, RELATIVE)
    assert abs(robot.mass - data.mass[0]) <= RELATIVE * data.mass[0]
    # links without mass leave the solution open to the rounding of the condition
    slack = max(RELATIVE, 4e-16 * float(np.linalg.cond(full)))
    if slack < 1e-3:
        close(robot.forward_dynamics(q, qd, mine), qdd, slack)


@pytest.mark.parametrize('path', EXAMPLES, ids=identity)
def test_example_robot_equals_the_free_flyer(path: Path) -> None:
    compare(without_dynamics(read(path)), '', seed=len(path.name))


def rigid(name: str) -> str:
    """A shipped robot without its flexibility, friction and the XML declaration."""
    text = without_dynamics(description(name))
    text = re.sub(r'<flexibility>.*</flexibility>', '', text, flags=re.S)
    return re.sub(r'^\s*<\?xml.*?\?>\s*', '', text, flags=re.S)


@pytest.mark.parametrize('name', ['canadarm', 'ssrms', 'puma', 'stanford'])
def test_shipped_robot_on_a_spacecraft_equals_the_free_flyer(name: str) -> None:
    compare(rigid(name), spacecraft(), seed=7)


@pytest.mark.parametrize('name', ['canadarm', 'ssrms', 'stanford_flexible'])
def test_joint_rows_of_flexible_arms_are_the_rigid_ones(name: str) -> None:
    """The rule of the format: undeformed, at rest in the amplitudes, base and joints are rigid."""
    text = re.sub('<actuator [^>]*/>', '', without_dynamics(description(name)))
    flexible = load_robot(floating(text, spacecraft()))
    plain = load_robot(floating(rigid(name), spacecraft()))
    rng = np.random.default_rng(8)
    states = rng.uniform(-1.0, 1.0, (3, plain.n))
    rows = np.sort(np.append(flexible.base_indices, flexible.joint_indices))
    spread = np.zeros((3, flexible.n))
    spread[:, rows] = states
    close(
        flexible.inverse_dynamics(spread[0], spread[1], spread[2])[rows],
        plain.inverse_dynamics(states[0], states[1], states[2]),
        RELATIVE,
    )
    block = flexible.inertia_matrix(spread[0])[np.ix_(rows, rows)]
    close(block, plain.inertia_matrix(states[0]), RELATIVE)
