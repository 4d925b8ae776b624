"""Which shape functions a beam needs: errors against the number of modes, and docs/shapes.md.

A uniform beam on a revolute joint, bare or with a point mass of `LOAD` times its own at its tip:
sag of the tip under gravity and first two natural frequencies, joint held (a cantilever) and joint
free (a pinned beam), against closed forms. Then the tip's rotation under a moment there, and the
frequencies with an inertia that turns with it. `python test/support/oracles/shape_study.py` writes
docs/shapes.md.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.model.beams.shapes import SHAPES
from denoc_ros.types import Array

LENGTH, EI, DENSITY = 2.0, 350.0, 1.7
GRAVITY = 1e-6  # so small that the sag is linear and no stiffness comes of it
LOAD = 10.0
INERTIA = 1.0  # of what turns with the tip, per mass and length^2 of the beam
MODES = (1, 2, 3, 4, 6, 8)
TITLES = {0.0: 'Bare beam', LOAD: f'Beam with {LOAD:g} times its mass at the tip'}
DOCUMENT = Path(__file__).resolve().parents[3] / 'docs' / 'shapes.md'


@cache
def beam(shape: str, modes: int, ratio: float, turning: float = 0.0) -> Robot:
    """The beam along X, bending in Y, with `ratio` times its mass at its tip, gravity along -Y.

    `turning` times its mass and length^2 is the inertia of what turns with the tip.
    """
    mass = DENSITY * LENGTH
    inertia = mass * LENGTH**2 / 12
    about = turning * mass * LENGTH**2
    zeros = ' '.join(f'{name}="0"' for name in ('ixx', 'ixy', 'ixz', 'iyy', 'iyz'))
    tip = (
        f'<inertial><mass value="{ratio * mass!r}"/><inertia {zeros} izz="{about!r}"/></inertial>'
    )
    text = f"""<robot name="beam"><link name="base"/>
      <link name="arm"><inertial><origin xyz="{LENGTH / 2!r} 0 0"/><mass value="{mass!r}"/>
        <inertia ixx="0" ixy="0" ixz="0" iyy="{inertia!r}" iyz="0" izz="{inertia!r}"/></inertial>
      </link><link name="tip">{tip if ratio or turning else ''}</link>
      <joint name="root" type="continuous"><parent link="base"/><child link="arm"/>
        <axis xyz="0 0 1"/></joint>
      <joint name="end" type="fixed"><parent link="arm"/><child link="tip"/>
        <origin xyz="{LENGTH!r} 0 0"/></joint>
      <flexibility><beam link="arm" length="{LENGTH!r}" shape="{shape}">
        <bending direction="y" ei="{EI!r}" modes="{modes}"/></beam></flexibility></robot>"""
    return load_robot(text, gravity=(0.0, -GRAVITY, 0.0))


def sag_error(shape: str, modes: int, ratio: float) -> float:
    """Relative error of the tip's sag with the joint held level."""
    robot = beam(shape, modes, ratio)
    found = -robot.tip_deflection('arm', robot.static_deflection(np.zeros(1)))[1]
    weight = DENSITY * LENGTH * GRAVITY
    exact = weight * LENGTH**3 / EI * (1.0 / 8.0 + ratio / 3.0)
    return abs(float(found) / exact - 1.0)


def frequency_errors(shape: str, modes: int, ratio: float, held: bool) -> Array:
    """Relative errors (2,) of the first two natural frequencies; NaN where there is none."""
    robot = beam(shape, modes, ratio)
    found = robot.natural_frequencies(np.zeros(robot.n), held)
    found = found if held else found[1:]  # the first is the rigid motion
    exact = hertz(roots(cantilever if held else pinned, ratio, 2))
    errors = np.full(2, np.nan)
    count = min(2, len(found))
    errors[:count] = found[:count] / exact[:count] - 1.0
    return errors


def cantilever(beta: float, ratio: float) -> float:
    """Frequency equation of a cantilever with a tip mass, over cosh(beta)."""
    tangent = np.tanh(beta)
    carried = ratio * beta * (np.cos(beta) * tangent - np.sin(beta))
    return float(1.0 / np.cosh(beta) + np.cos(beta) + carried)


def pinned(beta: float, ratio: float) -> float:
    """Frequency equation of a beam with a pinned root and a tip mass, over cosh(beta)."""
    tangent = np.tanh(beta)
    carried = 2.0 * ratio * beta * np.sin(beta) * tangent
    return float(np.sin(beta) - np.cos(beta) * tangent + carried)


def rotation_error(shape: str, modes: int) -> float:
    """Relative error of the tip's rotation under a moment there, joint held."""
    robot = beam(shape, modes, 0.0)
    wrench = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1e-6])
    bent = robot.static_deflection(np.zeros(1), {'tip': wrench})
    still = robot.static_deflection(np.zeros(1))
    poses = [robot.frame_pose('tip', q) for q in (bent, still)]
    turned = [np.arctan2(pose[1, 0], pose[0, 0]) for pose in poses]
    return abs(float(turned[0] - turned[1]) * EI / (1e-6 * LENGTH) - 1.0)


def turning_errors(shape: str, modes: int) -> Array:
    """Relative errors (2,) of the frequencies with `INERTIA` at the tip, joint held."""
    robot = beam(shape, modes, 0.0, INERTIA)
    found = robot.natural_frequencies(np.zeros(robot.n))
    exact = hertz(roots(turning_cantilever, INERTIA, 2))
    errors = np.full(2, np.nan)
    count = min(2, len(found))
    errors[:count] = np.abs(found[:count] / exact[:count] - 1.0)
    return errors


def turning_cantilever(beta: float, ratio: float) -> float:
    """Frequency equation of a clamped root and an inertia at the tip, over cosh(beta)^2.

    No shear force at the tip, and EI s'' = omega^2 J s' there with J = ratio m l^2.
    """
    cosh, sinh, cos, sin = np.cosh(beta), np.sinh(beta), np.cos(beta), np.sin(beta)
    bent = (cosh + cos) ** 2 - (sinh - sin) * (sinh + sin)
    turned = (sinh + sin) * (cosh + cos) - (sinh - sin) * (cosh - cos)
    return float((bent - ratio * beta**3 * turned) / cosh**2)


def roots(equation: Callable[[float, float], float], ratio: float, count: int) -> Array:
    """First positive roots of a frequency equation."""
    grid = np.linspace(0.3, 3.3 * (count + 1), 400)
    values = [equation(float(beta), ratio) for beta in grid]
    found = [
        brentq(equation, grid[k], grid[k + 1], (ratio,), xtol=1e-14)
        for k in range(len(grid) - 1)
        if values[k] * values[k + 1] < 0.0
    ]
    return np.array(found[:count])


def hertz(beta: Array) -> Array:
    """Frequencies [Hz] of wave numbers."""
    return np.asarray(beta**2 / LENGTH**2 * np.sqrt(EI / DENSITY) / (2.0 * np.pi))


def least_modes(shape: str) -> int:
    """The fewest modes that a shape may have."""
    return 2 if shape == 'craig-bampton' else 1


def document() -> str:
    """Text of docs/shapes.md."""
    parts = [HEAD]
    for ratio, title in TITLES.items():
        parts.append(f'## {title}\n')
        parts.append('Sag of the tip, joint held level:\n')
        parts.append(_table(partial(_sag, ratio)))
        for held, words in ((True, 'held (a cantilever)'), (False, 'free (a pinned beam)')):
            parts.append(f'First and second natural frequency, joint {words}:\n')
            parts.append(_table(partial(_frequencies, ratio, held)))
    parts.append(MOMENT)
    parts.append('Rotation of the tip under a moment there, joint held:\n')
    parts.append(_table(lambda shape, modes: [rotation_error(shape, modes)]))
    turning = f'with {INERTIA:g} times its mass and length^2 turning with the tip'
    parts.append(f'First and second natural frequency, joint held, {turning}:\n')
    parts.append(_table(lambda shape, modes: [float(e) for e in turning_errors(shape, modes)]))
    parts.append(TAIL)
    return '\n'.join(parts)


def _sag(ratio: float, shape: str, modes: int) -> list[float]:
    return [sag_error(shape, modes, ratio)]


def _frequencies(ratio: float, held: bool, shape: str, modes: int) -> list[float]:
    return [float(error) for error in frequency_errors(shape, modes, ratio, held)]


def _table(errors: Callable[[str, int], Sequence[float]]) -> str:
    lines = [
        '| modes | ' + ' | '.join(SHAPES) + ' |',
        '|---|' + '---|' * len(SHAPES),
    ]
    for modes in MODES:
        cells = [
            ', '.join(_text(value) for value in errors(shape, modes))
            if modes >= least_modes(shape)
            else '–'
            for shape in SHAPES
        ]
        lines.append(f'| {modes} | ' + ' | '.join(cells) + ' |')
    return '\n'.join(lines) + '\n'


def _text(error: float) -> str:
    """Two digits; what rounding decides is shown as such."""
    if np.isnan(error):
        return '–'
    return '< 1e-8' if abs(error) < 1e-8 else f'{error:.1e}'


HEAD = """# Which shape functions

Written by `python test/support/oracles/shape_study.py`; a test holds it to the code. Relative
errors of a uniform beam on a revolute joint against closed forms, for each `shape` and number of
`modes`. The link frame is tangent to the beam at its root for the clamped shapes and
craig-bampton; for pinned-pinned its X axis is the beam's chord.

The eigenvalues agree with the book's table 3.2 to its three decimals. Its last two rows have wrong
labels: 4.730, 7.853, ... belong to a beam with *both ends clamped* (a free beam has the same,
besides its two rigid motions, but is not a link on a joint), and 3.927, 7.069, ... belong to *one
end clamped and the other pinned*. A beam with one end fixed and the other free is the cantilever
of its second row.
"""

MOMENT = """## Moment and inertia at the tip

A link that carries a link is bent by moments as much as by forces.
"""

TAIL = """## Which to use

Where a file does not say, a beam that carries a mass or a loop beyond its root is craig-bampton,
from two modes on; another is clamped-free. `denoc check` prints for each beam the shape it took
and what it loses there: compliance under a force and under a moment, and the lowest natural
frequencies against those of the beam in 8 segments, with a remedy. `denoc export mjcf --verify`
compares with a simulator that has no shapes ([MuJoCo](mujoco.md)).

- **clamped-free** has the bare cantilever's frequencies exactly, as many as modes, and converges
  fastest to the bare pinned beam's. Its shapes have neither moment nor shear at the tip, so a tip
  load converges slowly: the sag under it is too small by the sum of 12 / beta_j^4 over the modes
  left out (2.9 % with one mode, 0.46 % with two), which falls as 1 / modes^3. Under a *moment*
  at the tip 20 % of its rotation is missing with two modes, 10 % with four, 5 % with eight:
  1 / modes. A link that carries a link is bent by moments: use others for such.
- **craig-bampton** contains the tip's static deflection and slope, so the tip's sag is exact under
  *any* load from two modes on, and a loaded cantilever's first frequency to 3e-6. With n modes
  n - 1 frequencies are good, and on a free joint n - 2. Use it for a link that carries
  a heavy link or payload.
- **clamped-clamped**, **clamped-pinned** and **pinned-pinned** shapes do not move the tip: with
  the joint held they do not sag, and vibrate like beams with a supported tip. On a *free* joint
  pinned-pinned is the best of all for a beam with a heavy tip, whose chord turns with the joint
  and whose ends are almost pinned, and so for links of loops.
"""


if __name__ == '__main__':
    DOCUMENT.write_text(document(), encoding='utf-8')
