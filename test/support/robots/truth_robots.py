"""Random robots whose model is off: serial arms with flexible links, elastic joints, sensors.

What is free is drawn with them, and so are the true numbers. Some draws hold numbers that no
record can tell: a payload beside the body that carries it, a joint that stands still, a gauge
that sees only what is slow.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.identification.model.free_parameters import FreeParameters
from denoc_ros.types import Array

OFF = 0.4  # true numbers are within +- 40 % of those of the model
SPREAD = 0.12  # deviation of a body's factors: its moments are off by as much
LATE = 5e-3  # s, largest delay of a topic
TRAPS = ('none', 'payload', 'still', 'slow', 'scale')


@dataclass(frozen=True)
class TruthCase:
    """A robot as its model says it, what is free, and where the truth is.

    Attributes
    ----------
    seed : int
    robot : Robot
        Where the search starts.
    free : tuple of str
    theta : (p,) array
        The true point of the search.
    trap : str
        One of `TRAPS`: what of it cannot be told.
    still : tuple of str
        Joints that do not move.
    held : bool
        A joint controller drives it; else its joints move as they are told.
    """

    seed: int
    robot: Robot
    free: tuple[str, ...]
    theta: Array
    trap: str
    still: tuple[str, ...]
    held: bool

    @property
    def parameters(self) -> FreeParameters:
        """The free numbers."""
        return FreeParameters(self.robot, self.free)


@dataclass
class _Draft:
    """Elements of a description while it is drawn."""

    links: str = ''
    joints: str = ''
    block: str = ''
    beams: list[str] = field(default_factory=list)
    elastic: list[str] = field(default_factory=list)
    rigid: list[str] = field(default_factory=list)
    gauges: list[str] = field(default_factory=list)
    imus: list[str] = field(default_factory=list)


def truth_case(seed: int, joints: int | None = None, trap: str | None = None) -> TruthCase:
    """Return the case of a seed.

    Parameters
    ----------
    seed : int
    joints : int, optional
        Default: 2 to 7, drawn.
    trap : str, optional
        One of `TRAPS`; default: drawn, half of them without.
    """
    draw = np.random.default_rng([seed, 17])
    count = joints or int(draw.integers(2, 8))
    drawn = TRAPS[int(draw.integers(1, len(TRAPS)))] if draw.random() < 0.5 else 'none'
    trap = trap or drawn
    draft, gravity = _draft(draw, count), draw.choice([0.0, -9.81])
    text = (
        f'<robot name="truth_{seed}"><link name="base"/>{draft.links}{draft.joints}'
        f'<flexibility>{draft.block}</flexibility></robot>'
    )
    robot = load_robot(text, gravity=(0.0, 0.0, gravity))
    robot = robot.with_overrides({'payload.tool.mass': float(draw.uniform(0.5, 2.0))})
    free = _free(draw, draft, trap, count)
    parameters = FreeParameters(robot, free)
    theta = _true_theta(draw, parameters)
    still = ('joint_1',) if trap == 'still' else ()
    held = trap in ('none', 'payload') and bool(draw.random() < 0.4)
    return TruthCase(seed, robot, tuple(free), theta, trap, still, held)


def _draft(draw: np.random.Generator, count: int) -> _Draft:
    """Draw the links from the base outwards."""
    bends = set(draw.choice(count, int(draw.integers(1, min(3, count) + 1)), replace=False))
    lengths = draw.uniform(0.4, 0.9, count)
    reach = np.cumsum(lengths[::-1])[::-1]
    has_imus = bool(draw.random() < 0.5)
    draft, place = _Draft(), 0.0
    for k in range(count):
        name, mass = f'link_{k + 1}', float(draw.uniform(1.0, 3.0) * lengths[k])
        weight = 1.5 * (count - k) + 1.0  # about what hangs on it, kg
        if k in bends:
            draft.links += _rod(name, lengths[k], mass, 0.0)
            _add_beam(draw, draft, name, float(lengths[k]), weight * reach[k] ** 2, has_imus)
        else:
            draft.links += _rod(name, lengths[k], mass, float(draw.uniform(-0.05, 0.05)))
            draft.rigid.append(name)
        _add_joint(draw, draft, k, place, weight * reach[k] ** 2)
        place = float(lengths[k])
    draft.links += '<link name="tool"/>'
    draft.joints += (
        f'<joint name="grip" type="fixed"><parent link="link_{count}"/><child link="tool"/>'
        f'<origin xyz="{place:.9g} 0 0"/></joint>'
    )
    return draft


def _rod(name: str, length: float, mass: float, off: float) -> str:
    """Return a link: a rod along x; one with an offset is a box beside it."""
    about = 0.0 if off == 0.0 else 4e-3 + mass * off**2
    across = mass * length**2 / 12 + (about if off else 0.0)
    return (
        f'<link name="{name}"><inertial><origin xyz="{length / 2:.9g} {off:.9g} {0.5 * off:.9g}"/>'
        f'<mass value="{mass:.9g}"/><inertia ixx="{about:.9g}" ixy="0" ixz="0" iyy="{across:.9g}" '
        f'iyz="0" izz="{across:.9g}"/></inertial></link>'
    )


def _add_beam(
    draw: np.random.Generator,
    draft: _Draft,
    name: str,
    length: float,
    inertia: float,
    has_imus: bool,
) -> None:
    """Make a link flexible: its tip swings what hangs on it with some hertz."""
    parts = ''
    for direction in ('y', 'z') if draw.random() < 0.4 else ('y',):
        rate = 2.0 * np.pi * draw.uniform(3.0, 7.0)
        ei, modes = rate**2 * inertia * length / 3.0, int(draw.integers(1, 3))
        ratio = draw.uniform(0.005, 0.02)
        parts += (
            f'<bending direction="{direction}" ei="{ei:.9g}" modes="{modes}" '
            f'damping_ratio="{ratio:.9g}"/>'
        )
        draft.beams.append(f'{name}.{direction}')
        if not has_imus or draw.random() < 0.3:
            gauge = f'{name}_{direction}'
            draft.block += (
                f'<sensor name="{gauge}" type="strain_gauge" link="{name}" '
                f'station="{0.07 * length:.9g}" direction="{direction}" surface="0.01" '
                f'gain="1e-6" offset="4e-5" topic="/{gauge}"/>'
            )
            draft.gauges.append(gauge)
    draft.block += f'<beam link="{name}" length="{length:.9g}" shape="clamped-free">'
    draft.block += f'{parts}</beam>'
    if has_imus:
        draft.block += (
            f'<sensor name="imu_{name}" type="imu" link="{name}" station="{length:.9g}" '
            f'topic="/imu_{name}"/>'
        )
        draft.imus.append(f'imu_{name}')


def _add_joint(
    draw: np.random.Generator, draft: _Draft, k: int, place: float, inertia: float
) -> None:
    name = f'joint_{k + 1}'
    parent = f'link_{k}' if k else 'base'
    roll = float(draw.choice([0.0, np.pi / 2, -np.pi / 2]))
    damping, friction = draw.uniform(0.02, 0.1) * inertia, draw.uniform(0.02, 0.1) * inertia
    draft.joints += (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/>'
        f'<child link="link_{k + 1}"/><origin xyz="{place:.9g} 0 0" rpy="{roll:.9g} 0 0"/>'
        f'<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1000" velocity="9"/>'
        f'<dynamics damping="{damping:.9g}" friction="{friction:.9g}"/></joint>'
    )
    armature = 0.1 * inertia
    if draw.random() < 0.2:
        rate = 2.0 * np.pi * draw.uniform(4.0, 9.0)
        stiffness = rate**2 * inertia
        draft.block += (
            f'<spring joint="{name}" stiffness="{stiffness:.9g}" '
            f'damping="{0.04 * stiffness / rate:.9g}"/>'
        )
        draft.elastic.append(name)
    draft.block += f'<actuator joint="{name}" armature="{armature:.9g}"/>'


def _free(draw: np.random.Generator, draft: _Draft, trap: str, count: int) -> list[str]:
    """Draw what is free: stiffness, payload and delays always, the rest by chance."""
    free = ['beam.*.ei', *(f'joint.{name}.stiffness' for name in draft.elastic)]
    free += ['delay.effort', *(f'delay.{name}' for name in (*draft.gauges, *draft.imus))]
    free += [f'sensor.{name}.offset' for name in (*draft.gauges, *draft.imus)]
    if draw.random() < 0.5:
        free += ['sensor.*.gain'] if draft.gauges else []
    if draw.random() < 0.5:
        free += ['joint.*.damping', 'joint.*.friction']
    if draw.random() < 0.4:
        free.append('beam.*.damping_ratio')
    free.append('payload.tool' if trap == 'payload' else 'payload.tool.mass')
    if trap == 'still':
        free += ['joint.*.damping', 'joint.*.friction']
    if trap == 'payload':
        free.append(f'link.link_{count}.inertial' if f'link_{count}' in draft.rigid else '')
    if trap == 'slow':
        free += ['sensor.*.gain'] if draft.gauges else []
        free += ['beam.*.damping_ratio']
    if trap == 'scale':
        free += ['effort.*.gain', 'joint.*.armature', 'joint.*.damping', 'joint.*.friction']
        free += [f'link.{name}.inertial' for name in draft.rigid[-1:]]
    if trap == 'none' and draft.rigid and draw.random() < 0.15:
        free.append(f'link.{draft.rigid[-1]}.inertial')
    return [path for path in dict.fromkeys(free) if path]


def _true_theta(draw: np.random.Generator, parameters: FreeParameters) -> Array:
    """Draw where the truth is."""
    theta = np.zeros(parameters.size)
    for k, number in enumerate(parameters.numbers):
        if number.path.startswith('delay.'):
            theta[k] = draw.uniform(-LATE, LATE) / number.scale
        elif number.positive:
            theta[k] = np.log(draw.uniform(1.0 - OFF, 1.0 + OFF))
        else:
            theta[k] = draw.uniform(-0.3, 0.3)
    first = len(parameters.numbers)
    theta[first:] = SPREAD * np.clip(draw.standard_normal(parameters.size - first), -2.0, 2.0)
    return theta
