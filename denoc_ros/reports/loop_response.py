"""Loops from a joint's torque to a joint, gauge or frame: response, poles, zeros, ringing."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.linear.linear_model import LinearModel
from denoc_ros.dynamics.linear.linearize import POSE
from denoc_ros.dynamics.linear.natural_modes import independent_joints
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import StateError
from denoc_ros.types import Array

Complex = NDArray[np.complex128]

RINGS = 0.05  # damping ratio below which a swing is seen: five swings to 20 %
DECAYED = 3.0  # time constants to 5 %
REAL_SHARE = 1e-3  # of its size: imaginary part of what does not swing
UNSEEN_SHARE = 1e-6  # of the largest: modes that input or output do not see
POINTS = 500


@dataclass(frozen=True)
class Swing:
    """A pair of poles or zeros that swings."""

    frequency: float  # Hz, undamped
    damping_ratio: float

    @property
    def decay(self) -> float:
        """Time to 5 % [s], infinite without damping."""
        rate = 2.0 * np.pi * self.frequency * self.damping_ratio
        return DECAYED / rate if rate > 0.0 else np.inf


@dataclass(frozen=True)
class LoopResponse:
    """Response from a joint's torque to an output, at one posture."""

    input: str
    output: str
    unit: str  # of the response
    collocated: bool  # the output is the very joint that is driven
    q: Array  # (n,)
    # [rad/s]
    poles: Complex
    zeros: Complex
    frequencies: Array  # (k,) [Hz]
    response: Complex  # (k,)
    # modes that the output shows in the phase opposite to that of its lowest motion: rate feedback
    # that damps the one drives the others
    opposed: tuple[Swing, ...]

    @property
    def swinging_poles(self) -> list[Swing]:
        """Poles that swing, by frequency."""
        return swings(self.poles)

    @property
    def swinging_zeros(self) -> list[Swing]:
        """Zeros that swing, by frequency."""
        return swings(self.zeros)

    @property
    def unstable_zero(self) -> float:
        """The smallest real zero in the right half plane [rad/s], infinite without one."""
        right = self.zeros[(self.zeros.real > 0.0) & ~_swinging(self.zeros)]
        return float(np.abs(right).min(initial=np.inf))

    @property
    def rings(self) -> bool:
        """Whether a loop on this output is expected to ring."""
        if self.collocated:
            return any(zero.damping_ratio < RINGS for zero in self.swinging_zeros)
        return np.isfinite(self.unstable_zero) or any(
            mode.damping_ratio < RINGS for mode in self.opposed
        )

    def sentence(self) -> str:
        """Return in words whether a loop is expected to ring, and why."""
        return _collocated(self) if self.collocated else _elsewhere(self)


def swings(values: Complex) -> list[Swing]:
    """Oscillating poles or zeros [rad/s], by frequency."""
    upper = values[_swinging(values) & (values.imag > 0.0)]
    found = [Swing(abs(s) / (2.0 * np.pi), float(-s.real / abs(s))) for s in upper]
    return sorted(found, key=lambda one: one.frequency)


def _swinging(values: Complex) -> NDArray[np.bool_]:
    return np.asarray(np.abs(values.imag) > REAL_SHARE * np.abs(values))


def _collocated(way: LoopResponse) -> str:
    zeros, poles = way.swinging_zeros, way.swinging_poles
    if not zeros:
        return f'A loop on {way.input} alone cannot ring: no link vibrates while it is held.'
    # the lowest of those that are left to swing
    zero = next((one for one in zeros if one.damping_ratio < RINGS), zeros[0])
    damped = f'{100 * zero.damping_ratio:.2g} % of critical damping'
    left = f'the links keep vibrating at {zero.frequency:.3g} Hz with {damped}{_decay(zero)}'
    verb = 'is expected to ring' if way.rings else 'is not expected to ring'
    text = f'A collocated loop on {way.input} {verb}: stiff, it clamps the joint, and {left}.'
    if poles:
        delay = 1e3 / (4.0 * poles[0].frequency)
        text += (
            f' Rate feedback damps the mode at {poles[0].frequency:.3g} Hz while its delay is '
            f'under {delay:.3g} ms.'
        )
    return text


def _decay(swing: Swing) -> str:
    if not np.isfinite(swing.decay):
        return ''
    time = f'{swing.decay:.0f}' if swing.decay >= 100.0 else f'{swing.decay:.3g}'
    return f' ({time} s to 5 %)'


def _elsewhere(way: LoopResponse) -> str:
    way_to = f'A loop from {way.output} to {way.input}'
    if not np.any(way.response):
        return f'{way_to} does nothing: {way.input} does not move it at this posture.'
    reasons = []
    if np.isfinite(way.unstable_zero):
        bound = way.unstable_zero / (4.0 * np.pi)
        reasons.append(
            f'a zero in the right half plane at {way.unstable_zero:.3g} rad/s keeps it below '
            f'about {bound:.2g} Hz'
        )
    ringing = [mode for mode in way.opposed if mode.damping_ratio < RINGS]
    if ringing:
        listed = ', '.join(f'{mode.frequency:.3g}' for mode in ringing[:4])
        more = ', ...' if len(ringing) > 4 else ''
        reasons.append(
            f'rate feedback that damps its lowest motion excites the modes at {listed}{more} Hz'
        )
    if reasons:
        return f'{way_to} is expected to ring: {"; ".join(reasons)}.'
    return f'{way_to} is not expected to ring: all modes answer in one phase, or are well damped.'


def loop_response(
    robot: Robot,
    q: Array,
    drive: str,
    output: str,
    free: bool = False,
    span: tuple[float, float] | None = None,
) -> LoopResponse:
    """Return the way from a joint's torque to an output at a posture at rest.

    Parameters
    ----------
    q : (n,)
        In equilibrium, closed where there are loops.
    drive : joint name
    output : str
        A joint, a sensor, a frame (its displacement along the way in which the joint moves it,
        or its turn about the joint's axis where that is none), or `<frame>/<x|y|z|rx|ry|rz>`.
    free : bool
        Whether the other joints are free; else they are held.
    span : (2,) [Hz], optional
        Of the frequencies; default from well below the lowest pole or zero to above the highest.

    Raises
    ------
    StateError
        For a name that the robot does not have.
    """
    robot.indices([drive])
    used = {drive, output}
    others = [name for name in independent_joints(robot, q) if name not in used]
    locked = [] if free else others
    model, unit = _one_output(robot, q, drive, output, locked)
    poles, zeros = model.poles(), model.zeros(0, 0)
    frequencies = _grid(poles, zeros, span)
    response = model.frequency_response(2.0 * np.pi * frequencies)[:, 0, 0]
    return LoopResponse(
        drive, output, unit, drive == output, q, poles, zeros, frequencies, response,
        _opposed(model),
    )  # fmt: skip


def _one_output(
    robot: Robot, q: Array, drive: str, output: str, locked: list[str]
) -> tuple[LinearModel, str]:
    """Return a model of one input and one output, and the unit of its response."""
    joints = robot.tree.joints
    per = joints[drive].effort_unit
    frame, slash, part = output.rpartition('/')
    if output in joints:
        named, unit = output, joints[output].unit
    elif output in {sensor.name for sensor in robot.tree.sensors}:
        named, unit = output, '1'
    elif slash and frame in robot.tree.frames and part in POSE:
        named, unit = f'pose:{frame}', 'rad' if part.startswith('r') else 'm'
    elif output in robot.tree.frames:
        frame, part, named = output, '', f'pose:{output}'
    else:
        known = ', '.join((*robot.joint_names, *(s.name for s in robot.tree.sensors)))
        frames = ', '.join(robot.tree.frames)
        raise StateError(
            f'output must be a joint or sensor ({known}), a frame ({frames}) or '
            f'<frame>/<{"|".join(POSE)}>, got {output!r}'
        )
    model = robot.linearize(q, inputs=(drive,), outputs=(named,), locked=locked, friction=False)
    if not named.startswith('pose:'):
        return model, f'{unit}/({per})'
    row = np.eye(6)[POSE.index(part)] if part else _direction(robot, q, drive, frame)
    if not part:
        unit = 'm' if row[:3].any() else 'rad'
    made = replace(model, c=row[None] @ model.c, d=row[None] @ model.d, output_names=(output,))
    return made, f'{unit}/({per})'


def _direction(robot: Robot, q: Array, drive: str, frame: str) -> Array:
    """Return the unit displacement (6,), or turn, that a joint alone gives a frame."""
    index = int(robot.indices([drive])[0])
    column = robot.frame_jacobian(frame, q)[:, index].copy()
    if np.linalg.norm(column[:3]) > 1e-9:
        column[3:] = 0.0
    size = float(np.linalg.norm(column))
    return np.asarray(column / size if size else np.eye(6)[0])


def _opposed(model: LinearModel) -> tuple[Swing, ...]:
    """Return the modes that an output shows in the phase opposite to its lowest motion's."""
    poles, residues = model.residues(0, 0)
    swinging = _swinging(poles) & (poles.imag > 0.0)
    poles, residues = poles[swinging], residues[swinging]
    order = np.argsort(np.abs(poles))
    poles, residues = poles[order], residues[order]
    # of r / (s^2 + w^2) the residue at i w is r / (2 i w)
    strength = (2j * np.abs(poles) * residues).real
    seen = np.abs(strength) > UNSEEN_SHARE * np.abs(strength).max(initial=0.0)
    lowest = _rigid_strength(model)
    if lowest == 0.0 and seen.any():
        lowest = float(strength[seen][0])
    against = seen & (strength * lowest < 0.0)
    return tuple(swings(np.asarray(poles[against])))


def _rigid_strength(model: LinearModel) -> float:
    """Return the sign of motion that no spring holds, 0 where there is none."""
    poles = model.poles()
    slow = np.abs(poles[~_swinging(poles)])
    swing = np.abs(poles[_swinging(poles)])
    if not len(slow):
        return 0.0
    omega = 1e-2 * float(swing.min()) if len(swing) else 1e-2
    near, far = model.frequency_response([omega, 0.1 * omega])[:, 0, 0]
    # without a spring it grows with the square of the period; a gauge does not see it
    return float(np.sign(-near.real)) if abs(far) > 10.0 * abs(near) else 0.0


def _grid(poles: Complex, zeros: Complex, span: tuple[float, float] | None) -> Array:
    """Return frequencies [Hz] that show every resonance: evenly by logarithm, dense there."""
    found = [one.frequency for one in (*swings(poles), *swings(zeros))]
    sizes = [abs(s) / (2.0 * np.pi) for s in (*poles, *zeros) if s != 0.0]
    low, high = span or (0.1 * min(found or sizes or [1.0]), 3.0 * max(found or sizes or [1.0]))
    even = np.geomspace(low, high, POINTS)
    near = [f * (1.0 + np.geomspace(1e-4, 0.1, 12)[:, None] * [-1.0, 1.0]) for f in found]
    every = np.concatenate([even, *(part.ravel() for part in near)])
    return np.unique(every[(every >= low) & (every <= high)])
