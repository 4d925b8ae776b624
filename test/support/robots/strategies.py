"""Random flexible robots as URDF text, and random states: for hypothesis or from a seed.

Robots are physically possible: a flexible link's `<inertial>` is its beam plus a rigid rest made
of point masses. Trees branch, joints are revolute, continuous or prismatic about any axis, beams
lie off the link's axes, children hang at mid-span or on fixed payloads.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from denoc_ros.types import Array

SHAPES = ('clamped-free', 'clamped-clamped', 'clamped-pinned', 'pinned-pinned', 'craig-bampton')


class Source(Protocol):
    """Where random choices come from."""

    def number(self, low: float, high: float) -> float: ...
    def integer(self, low: int, high: int) -> int: ...


@dataclass
class Seeded:
    """Choices of a numpy generator."""

    rng: np.random.Generator

    def number(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))

    def integer(self, low: int, high: int) -> int:
        return int(self.rng.integers(low, high + 1))


@dataclass
class Drawn:
    """Choices of hypothesis: on a grid, so that examples shrink to readable numbers."""

    draw: Callable[[Any], Any]

    def number(self, low: float, high: float) -> float:
        return low + (high - low) * self.integer(0, 1000) / 1000

    def integer(self, low: int, high: int) -> int:
        return int(self.draw(st.integers(low, high)))


def _yes(source: Source, one_in: int = 2) -> bool:
    return source.integer(1, one_in) == 1


def _vector(source: Source, size: float) -> Array:
    return np.array([source.number(-size, size) for _ in range(3)])


def _text(values: Array | list[float]) -> str:
    return ' '.join(repr(float(v)) for v in values)


def _origin(position: Array, angles: Array) -> str:
    return f'<origin xyz="{_text(position)}" rpy="{_text(angles)}"/>'


def _matrix(angles: Array) -> Array:
    return np.asarray(Rotation.from_euler('xyz', angles).as_matrix())


@dataclass(frozen=True)
class Mass:
    """Inertia about a link frame's origin: mass, mass * com, (3, 3)."""

    mass: float
    first_moment: Array
    inertia: Array

    def __add__(self, other: Mass) -> Mass:
        return Mass(
            self.mass + other.mass,
            self.first_moment + other.first_moment,
            self.inertia + other.inertia,
        )


def _points(source: Source, size: float) -> Mass:
    """Four point masses and a little ball's inertia: a body that is always possible."""
    total = Mass(0.0, np.zeros(3), 0.002 * np.eye(3))  # never singular, wherever the points are
    for _ in range(4):
        m, p = source.number(0.05, 1.0), _vector(source, size)
        total = total + Mass(m, m * p, m * (p @ p * np.eye(3) - np.outer(p, p)))
    return total


def _rod(length: float, density: float, polar: float, position: Array, R: Array) -> Mass:
    """A slender rod along the x axis of a frame (position, R) seen from the link."""
    m, e = density * length, R[:, 0]
    centre = position + length / 2 * e
    about_com = m * length**2 / 12 * (np.eye(3) - np.outer(e, e)) + polar * length * np.outer(e, e)
    about_origin = about_com + m * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return Mass(m, m * centre, about_origin)


def _inertial(body: Mass, angles: Array) -> str:
    com = body.first_moment / body.mass
    central = body.inertia - body.mass * (com @ com * np.eye(3) - np.outer(com, com))
    R = _matrix(angles)
    I = R.T @ central @ R
    names = (
        ('ixx', 0, 0),
        ('ixy', 0, 1),
        ('ixz', 0, 2),
        ('iyy', 1, 1),
        ('iyz', 1, 2),
        ('izz', 2, 2),
    )
    terms = ' '.join(f'{name}="{float(I[i, j])!r}"' for name, i, j in names)
    return (
        f'<inertial>{_origin(com, angles)}<mass value="{float(body.mass)!r}"/>'
        f'<inertia {terms}/></inertial>'
    )


@dataclass(frozen=True)
class Link:
    """A link that others may hang on: its text, and its beam's axis when it has one."""

    name: str
    urdf: str
    beam: str = ''
    length: float = 0.0
    position: Array | None = None
    R: Array | None = None


def _bending(source: Source, direction: str, least: int, length: float) -> str:
    modes = source.integer(least, 3)
    if modes == 0:
        return ''
    ei = length**3 * 10 ** source.number(2.0, 4.0)
    ratios = [source.number(0.0, 0.05) for _ in range(modes if _yes(source) else 1)]
    return (
        f'<bending direction="{direction}" ei="{ei!r}" modes="{modes}" '
        f'damping_ratio="{_text(ratios)}"/>'
    )


def _flexible_link(source: Source, name: str) -> Link:
    length, density = source.number(0.4, 3.0), source.number(0.2, 3.0)
    polar = source.number(0.002, 0.05)
    position, angles = _vector(source, 0.2), _vector(source, 1.5)
    if _yes(source, 3):
        position, angles = np.zeros(3), np.zeros(3)
    R, shape = _matrix(angles), SHAPES[source.integer(0, len(SHAPES) - 1)]
    least = 2 if shape == 'craig-bampton' else 0
    parts = [_bending(source, axis, least, length) for axis in 'yz' if not _yes(source, 4)]
    twist = source.integer(0, 2)
    if twist:
        gj = length * 10 ** source.number(2.0, 3.0)
        parts.append(
            f'<torsion gj="{gj!r}" polar_inertia="{polar!r}" modes="{twist}" '
            'damping_ratio="0.01"/>'
        )
    rod = _rod(length, density, polar if twist else 0.0, position, R)
    body = rod + _points(source, 0.3)
    link = f'<link name="{name}">{_inertial(body, _vector(source, 1.0))}</link>'
    beam = (
        f'<beam link="{name}" length="{length!r}" mass_per_length="{density!r}" shape="{shape}">'
        f'{_origin(position, angles)}{"".join(parts)}</beam>'
    )
    return Link(name, link, beam, length, position, R)


def _rigid_link(source: Source, name: str) -> Link:
    body = _points(source, 0.5)
    return Link(name, f'<link name="{name}">{_inertial(body, _vector(source, 1.0))}</link>')


def _place(source: Source, parent: Link) -> Array:
    """Where a child's joint stands in the parent's link frame: on the beam, or off it."""
    if parent.R is None or parent.position is None:
        return _vector(source, 0.6)
    station = (parent.length, parent.length / 2, parent.length * 1.1, -0.1)[source.integer(0, 3)]
    arm = _vector(source, 0.2) if _yes(source) else np.zeros(3)
    return parent.position + parent.R @ (np.array([station, 0.0, 0.0]) + arm * [0, 1, 1])


def _dynamics(source: Source) -> str:
    if _yes(source):
        return ''
    damping, friction = source.number(0.0, 2.0), source.number(0.0, 1.0)
    return f'<dynamics damping="{damping!r}" friction="{friction!r}"/>'


def _joint(source: Source, kind: str, parent: Link, child: str) -> str:
    axis = _vector(source, 1.0)
    if np.linalg.norm(axis) < 0.1:
        axis = np.array([0.0, 0.0, 1.0])
    moves = '' if kind == 'fixed' else f'<axis xyz="{_text(axis)}"/>{_dynamics(source)}'
    limit = '<limit lower="-3" upper="3" effort="100" velocity="5"/>'
    return (
        f'<joint name="joint_{child}" type="{kind}"><parent link="{parent.name}"/>'
        f'<child link="{child}"/>{_origin(_place(source, parent), _vector(source, 1.5))}{moves}'
        f'{limit if kind in ("revolute", "prismatic") else ""}</joint>'
    )


def _kind(source: Source) -> str:
    return ('revolute', 'continuous', 'prismatic', 'revolute', 'fixed')[source.integer(0, 4)]


def robot_text(source: Source, links: int = 5) -> str:
    """URDF text of a random flexible robot with `links` links and at least one coordinate."""
    root = _flexible_link(source, 'base') if _yes(source, 4) else _rigid_link(source, 'base')
    made, joints, extra = [root], [], ''
    for k in range(1, links + 1):
        name = f'l{k}'
        child = (_flexible_link if _yes(source) else _rigid_link)(source, name)
        parent = made[source.integer(max(0, len(made) - 2), len(made) - 1)]
        kind = 'revolute' if k == 1 else _kind(source)
        joints.append(_joint(source, kind, parent, name))
        made.append(child)
        if kind != 'fixed' and _yes(source, 3):
            armature = source.number(0.0, 0.5)
            extra += f'<actuator joint="joint_{name}" armature="{armature!r}"/>'
    beams = ''.join(link.beam for link in made)
    body = ''.join(link.urdf for link in made) + ''.join(joints)
    return f'<robot name="random">{body}<flexibility>{beams}{extra}</flexibility></robot>'


def seeded_robot(seed: int, links: int = 5) -> str:
    """The same, from a seed."""
    return robot_text(Seeded(np.random.default_rng(seed)), links)


@st.composite
def _drawn_robot(draw: Any, most: int) -> str:
    return robot_text(Drawn(draw), draw(st.integers(1, most)))


def robots(most: int = 5) -> st.SearchStrategy[str]:
    """Hypothesis strategy of robots' URDF text with up to `most` links after the root.

    Half of them come from seeds: evenly spread, where drawn ones tend to be small and alike.
    """
    seeded = st.builds(seeded_robot, st.integers(0, 10**6), st.integers(2, most))
    return st.one_of(_drawn_robot(most), seeded)


@dataclass(frozen=True)
class State:
    """Coordinates, rates and accelerations."""

    q: Array
    qd: Array
    qdd: Array


def random_state(names: tuple[str, ...] | list[str], seed: int, deflection: float = 0.05) -> State:
    """A state of a robot by its `coordinate_names`: amplitudes are those named `link/y1`.

    Parameters
    ----------
    names : sequence of str
        Coordinates' names.
    seed : int
        Of the generator.
    deflection : float
        Largest amplitude [m, rad]; rates are up to ten times that per second.
    """
    rng = np.random.default_rng(seed)
    size = np.array([deflection if '/' in name else 2.0 for name in names])
    q, qd, qdd = rng.uniform(-1, 1, (3, len(size)))
    speed = np.where(size < 1, 10 * deflection, 2.0)
    return State(q * size, qd * speed, qdd * np.where(size < 1, 50 * deflection, 5.0))


seeds = st.integers(0, 2**32 - 1)


def law(examples: int) -> settings:
    """Settings of a law: the same examples each run; shrinking a robot would take minutes."""
    return settings(
        max_examples=examples,
        deadline=None,
        derandomize=True,
        phases=(Phase.explicit, Phase.generate),
        suppress_health_check=[HealthCheck.too_slow],
    )
