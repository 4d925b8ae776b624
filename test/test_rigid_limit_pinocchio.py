"""Rigid robots, and flexible ones held undeformed, against Pinocchio on the same file.

Every URDF of the example-robot-data package stands on a fixed base here, legged ones too.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib.metadata import files
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from numpy.typing import NDArray
from strategies import law, robots

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.types import Array

# a <robot> with no name; mimic joints of a leader that is not there; no joint that moves (two)
LEFT_OUT = {'ur3.urdf', 'alex_psyonic_hands.urdf', 'quadrotor_base.urdf', 'iris_simple.urdf'}
EXAMPLES = sorted(
    Path(str(file.locate()))
    for file in files('example-robot-data') or []
    if file.suffix == '.urdf' and file.name not in LEFT_OUT
)
FLEXIBLE = sorted(
    path
    for path in (Path(__file__).resolve().parent.parent / 'config' / 'robots').glob('*.urdf')
    if re.search('type="(revolute|continuous|prismatic)"', path.read_text())
    and 'type="floating"' not in path.read_text()  # see test_floating_pinocchio
)
RELATIVE = 1e-10  # rounding of two recursions over up to 111 coordinates


@dataclass(frozen=True)
class Peer:
    """Pinocchio's model of a file, its coordinates in our order."""

    model: pin.Model
    order: NDArray[np.int_]  # of our joints among its velocities

    def configuration(self, names: list[str], q: Array) -> Array:
        """Its configuration: continuous joints are (cos, sin)."""
        full = pin.neutral(self.model)
        for name, value in zip(names, q, strict=True):
            joint = self.model.joints[self.model.getJointId(name)]
            at = joint.idx_q
            full[at : at + joint.nq] = [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
        return np.asarray(full)

    def spread(self, values: Array) -> Array:
        """Our joints' values in its order."""
        out = np.zeros(self.model.nv)
        out[self.order] = values
        return out


def peer_of(text: str, names: list[str]) -> Peer:
    model = pin.buildModelFromXML(text)
    assert model.nv == len(names)
    order = [model.joints[model.getJointId(name)].idx_v for name in names]
    return Peer(model, np.array(order, dtype=int))


def read(path: Path) -> str:
    """Text without its XML declaration, which Pinocchio refuses in a string."""
    return re.sub(r'^\s*<\?xml.*?\?>\s*', '', path.read_text(encoding='utf-8'), flags=re.S)


def without_dynamics(text: str) -> str:
    return re.sub(r'<dynamics\b[^>]*?(/>|>\s*</dynamics>)', '', text)


def friction(text: str, names: list[str], qd: Array) -> Array:
    """Damping and Coulomb friction of the file at these rates."""
    force = np.zeros(len(names))
    for joint in ElementTree.fromstring(text).iter('joint'):
        dynamics = joint.find('dynamics')
        if joint.get('name') in names and dynamics is not None:
            k = names.index(str(joint.get('name')))
            force[k] += float(dynamics.get('damping', 0)) * qd[k]
            force[k] += float(dynamics.get('friction', 0)) * np.tanh(qd[k] / 1e-3)
    return force


def close(value: Array, expected: Array, relative: float = RELATIVE) -> None:
    scale = max(float(np.abs(expected).max()), 1e-6)
    np.testing.assert_allclose(value, expected, rtol=0, atol=relative * scale)


def states(robot: Robot, seed: int) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(seed)
    q, qd, qdd = rng.uniform(-1, 1, (3, robot.n))
    return 3 * q, 2 * qd, 5 * qdd


def identity(path: Path) -> str:
    return f'{path.parent.parent.name}-{path.stem}'


def compare_rigid(text: str, seed: int) -> None:
    """Inverse and forward dynamics and inertia matrix of a robot without amplitudes."""
    robot = load_robot(text)
    names = list(robot.joint_names)
    peer = peer_of(text, names)
    data = peer.model.createData()
    q, qd, qdd = states(robot, seed)
    place, rate = peer.configuration(names, q), peer.spread(qd)
    tau = pin.rnea(peer.model, data, place, rate, peer.spread(qdd))[peer.order]
    close(robot.inverse_dynamics(q, qd, qdd), tau)
    upper = np.triu(pin.crba(peer.model, data, place))
    full = (upper + np.triu(upper, 1).T)[np.ix_(peer.order, peer.order)]
    close(robot.inertia_matrix(q), full)
    # massless or nearly massless links leave the solution open to the condition's rounding
    slack = max(RELATIVE, 4e-16 * float(np.linalg.cond(full)))
    theirs = pin.aba(peer.model, data, place, rate, peer.spread(tau))[peer.order]
    if slack < 1e-3:
        close(robot.forward_dynamics(q, qd, tau), theirs, slack)


@pytest.mark.parametrize('path', EXAMPLES, ids=identity)
def test_rigid_robot_equals_pinocchio(path: Path) -> None:
    compare_rigid(without_dynamics(read(path)), seed=len(path.name))


def test_enough_example_robots_were_compared() -> None:
    assert len(EXAMPLES) >= 60
    assert {'ur5_robot', 'panda', 'xarm7', 'kinova'} <= {path.stem for path in EXAMPLES}


@pytest.mark.parametrize('path', EXAMPLES, ids=identity)
def test_joint_friction_adds_to_pinocchio(path: Path) -> None:
    text = read(path)
    robot = load_robot(text)
    names = list(robot.joint_names)
    peer = peer_of(without_dynamics(text), names)
    q, qd, qdd = states(robot, seed=1)
    qd[::2] *= 1e-3  # where tanh is not saturated
    place = peer.configuration(names, q)
    data = peer.model.createData()
    tau = pin.rnea(peer.model, data, place, peer.spread(qd), peer.spread(qdd))[peer.order]
    close(robot.inverse_dynamics(q, qd, qdd), tau + friction(text, names, qd))


def compare_undeformed(text: str) -> None:
    """The rule of the format: joint rows and block at rest in the amplitudes, at d = 0."""
    robot = load_robot(text)
    names, joints = list(robot.joint_names), np.asarray(robot.joint_indices)
    armature = np.zeros(len(names))
    for actuator in ElementTree.fromstring(text).iter('actuator'):
        armature[names.index(str(actuator.get('joint')))] = float(actuator.get('armature', 0))
    peer = peer_of(text, names)
    data = peer.model.createData()
    q, qd, qdd = np.zeros((3, robot.n))
    for values, seed in ((q, 1), (qd, 2), (qdd, 3)):
        values[joints] = np.random.default_rng(seed).uniform(-2, 2, len(joints))
    place, rate = peer.configuration(names, q[joints]), peer.spread(qd[joints])
    tau = pin.rnea(peer.model, data, place, rate, peer.spread(qdd[joints]))[peer.order]
    tau = tau + armature * qdd[joints] + friction(text, names, qd[joints])
    close(robot.inverse_dynamics(q, qd, qdd)[joints], tau)
    upper = np.triu(pin.crba(peer.model, data, place))
    full = (upper + np.triu(upper, 1).T)[np.ix_(peer.order, peer.order)]
    close(robot.inertia_matrix(q)[np.ix_(joints, joints)], full + np.diag(armature))


@pytest.mark.parametrize('path', FLEXIBLE, ids=lambda path: path.stem)
def test_undeformed_flexible_robot_equals_pinocchio(path: Path) -> None:
    compare_undeformed(read(path))


@law(20)
@given(text=robots())
def test_undeformed_random_tree_equals_pinocchio(text: str) -> None:
    compare_undeformed(text)


@law(15)
@given(text=robots())
def test_beams_without_modes_are_rigid_links(text: str) -> None:
    text = re.sub(r'modes="\d+"', 'modes="0"', without_dynamics(text))
    text = re.sub(r' damping_ratio="[^"]*"|<actuator [^>]*/>', '', text)
    compare_rigid(text.replace('craig-bampton', 'clamped-free'), seed=1)


def test_flexible_robots_were_compared() -> None:
    stems = {path.stem for path in FLEXIBLE}
    assert len(stems) >= 4
    assert any('canadarm' in stem for stem in stems)
    assert any('ssrms' in stem for stem in stems)
