"""Damping of a model's beams and joints from measured natural modes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares, linear_sum_assignment, nnls

from denoc_ros.dynamics.driven.measured_side import measured_equilibrium
from denoc_ros.dynamics.linear.natural_modes import stiffness
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import IdentificationError
from denoc_ros.model.beams.segments import deformations, whole_beams
from denoc_ros.model.numbers import values_of
from denoc_ros.types import Array

USABLE = ('good', 'doubtful')  # verdicts of modes that damping is assigned from
FARTHEST = 0.3  # of a measured frequency: no mode of the model beyond is taken for it
FIRST_OF_EQUALS = 1e-6  # of a share
LOG_RATIO_BOUNDS = (np.log(1e-7), np.log(2.0))


@dataclass(frozen=True)
class Assigned:
    """The damping of one amplitude, from one measured mode."""

    mode: int  # place of the measured mode among those given
    coordinate: str  # as in the robot's `coordinate_names`, such as `arm/y1`
    path: str  # the dotted path of its beam's damping ratios, such as `beam.arm.y.damping_ratio`
    place: int  # its place among them, from 0
    model_hz: float  # frequency of the model's mode that was taken for it [Hz]
    share: float  # of that mode's strain energy in this amplitude
    damping_ratio: float  # of the amplitude, at a fixed root
    coefficient: float  # 2 damping_ratio sqrt(k m) [unit]
    unit: str  # of the coefficient, for shape functions with max |s| = 1 on the beam


@dataclass(frozen=True)
class _Amplitude:
    """Object of one damping ratio: an amplitude, or a deformation of all segments of a link."""

    coordinate: str  # the first
    index: NDArray[np.int64]
    path: str
    place: int
    critical: Array  # of each coordinate
    unit: str


def assign_damping(
    robot: Robot,
    q: ArrayLike,
    frequency: ArrayLike,
    damping_ratio: ArrayLike,
    held: bool = True,
    size: ArrayLike | None = None,
) -> list[Assigned]:
    """Return the damping ratios of amplitudes with which a model has the measured ones.

    Each measured mode is taken for the model's mode nearest in frequency, and determines the
    amplitude that has most of its strain energy; the ratios of these amplitudes are then found
    together, all other damping staying as it is in the model.

    Parameters
    ----------
    q : (n,)
        Where it rang; amplitudes may be zero.
    frequency, damping_ratio : (k,)
        Measured: undamped natural frequencies [Hz] and damping ratios.
    held : bool
        Whether the joints were locked, or free.
    size : (k,), optional
        How large they are: of two that fall on one mode of the model, the larger is it. A
        measured mode farther than 30 % from all of the model's is left out.

    Raises
    ------
    IdentificationError
        When no measured mode is one of the model's, or no damping explains them.

    Notes
    -----
    The modes are those of I q'' + C q' + K q = 0 linearized at q, by its complex eigenvalues:
    strong and unproportional damping included.
    """
    state = np.asarray(q, dtype=np.float64)
    measured = np.atleast_1d(np.asarray(frequency, dtype=np.float64))
    ratios = np.atleast_1d(np.asarray(damping_ratio, dtype=np.float64))
    sizes = np.ones(measured.shape) if size is None else np.asarray(size, dtype=np.float64)
    modes = robot.natural_modes(state, held)
    pairs = _matched(robot.tree.name, modes.frequencies, measured, sizes)
    of, matched = list(pairs), list(pairs.values())
    measured, ratios = measured[of], ratios[of]
    amplitudes, squares = _amplitudes(robot), modes.shapes[:, matched] ** 2
    shares = np.array([robot.stiffness[a.index] @ squares[a.index] for a in amplitudes])
    shares = shares / np.maximum(shares.sum(axis=0), 1e-300)
    # of a link of segments one ratio holds for all its modes: that of the first is taken
    ranks = FIRST_OF_EQUALS * np.argsort(np.argsort(modes.frequencies[matched]))
    kept, chosen = linear_sum_assignment(ranks[:, None] - shares.T)
    of, matched = [of[k] for k in kept], [matched[k] for k in kept]
    measured, ratios, shares = measured[kept], ratios[kept], shares[:, kept]
    system = _Linearized(robot, state, held)
    picked = [amplitudes[k] for k in chosen]
    damped = [one.critical @ squares[one.index][:, kept] for one in picked]
    solved = system.solve(picked, measured, ratios, modes.frequencies[matched], np.array(damped))
    return [
        Assigned(
            mode=of[k],
            coordinate=amplitude.coordinate,
            path=amplitude.path,
            place=amplitude.place,
            model_hz=float(modes.frequencies[matched[k]]),
            share=float(shares[chosen[k], k]),
            damping_ratio=float(solved[k]),
            coefficient=float(solved[k] * amplitude.critical[0]),
            unit=amplitude.unit,
        )
        for k, amplitude in enumerate(picked)
    ]


def damping_overrides(robot: Robot, assigned: Sequence[Assigned]) -> dict[str, list[float]]:
    """Return whole lists of damping ratios by dotted path, those assigned put in their places."""
    overrides: dict[str, list[float]] = {}
    present = values_of(robot.tree)
    for one in assigned:
        whole = overrides.setdefault(one.path, np.atleast_1d(present[one.path]).tolist())
        whole[one.place] = float(f'{one.damping_ratio:.6g}')
    return overrides


def _matched(name: str, model: Array, measured: Array, size: Array) -> dict[int, int]:
    """Return the model's mode of each measured one that has one, the largest where several do."""
    vibrating = np.flatnonzero(model > 0.0)
    taken: dict[int, int] = {}
    for k in np.argsort(-size, kind='stable').tolist():
        distance = np.abs(np.log(model[vibrating] / measured[k]))
        nearest = int(np.argmin(distance)) if distance.size else -1
        if nearest >= 0 and distance[nearest] <= FARTHEST:
            taken.setdefault(int(vibrating[nearest]), k)
    if not taken:
        raise IdentificationError(
            f'{name}: a measured mode must be within {100 * FARTHEST:g} % of one of the '
            f"model's ({_listed(model[vibrating])} Hz), got {_listed(measured)} Hz"
        )
    return {k: mode for mode, k in sorted(taken.items())}


def _listed(values: Array) -> str:
    return ', '.join(f'{value:.4g}' for value in values) or 'none'


def _amplitudes(robot: Robot) -> list[_Amplitude]:
    found = []
    for beam in whole_beams(robot.tree):
        first = robot.amplitudes(beam.link).start
        others = [[each for _, _, each in deformations(part)] for part in beam.beams]
        for order, (name, _, critical) in enumerate(deformations(beam.segment)):
            path = f'beam.{beam.link}.{name}.damping_ratio'
            unit = 'N m s/rad' if name == 'torsion' else 'N s/m'
            own = first + np.arange(len(critical))
            first += len(critical)
            alike = (own + beam.modes * np.arange(beam.segments)[:, None]).ravel()
            each, values = list(own[:, None]), list(critical[:, None])
            if beam.segments > 1:
                each, values = [alike], [np.concatenate([each[order] for each in others])]
            for place, (index, value) in enumerate(zip(each, values, strict=True)):
                coordinate = robot.coordinate_names[index[0]]
                found.append(_Amplitude(coordinate, index, path, place, value, unit))
    return found


class _Linearized:
    """I q'' + C q' + K q = 0 of the coordinates that move."""

    def __init__(self, robot: Robot, q: Array, held: bool) -> None:
        self._name = robot.tree.name
        self._moving = robot.flexible_indices if held else np.arange(robot.n)
        block = np.ix_(self._moving, self._moving)
        self._mass = robot.inertia_matrix(q)[block]
        self._stiffness = stiffness(robot, q)[block]
        self._damping = robot.damping.copy()

    def solve(
        self,
        picked: Sequence[_Amplitude],
        measured: Array,
        ratios: Array,
        model: Array,
        damped: Array,
    ) -> Array:
        """Return the damping ratios of amplitudes at which the modes have the measured ratios.

        `model` are the frequencies [Hz] of the undamped modes, `damped` (picked, modes) what the
        critical damping of the picked amplitudes is at their unit modal mass.
        """
        target = np.log(ratios)

        def residual(logs: Array) -> Array:
            damping = self._damping.copy()
            for one, log in zip(picked, logs, strict=True):
                damping[one.index] = np.exp(log) * one.critical
            return np.log(np.maximum(self._ratios(damping, model), 1e-12)) - target

        # to first order in the damping it is linear
        first = nnls(damped.T, 4.0 * np.pi * model * ratios)[0]
        lowest, highest = np.exp(LOG_RATIO_BOUNDS)
        start = np.log(np.clip(first, 10.0 * lowest, 0.9 * highest))
        found = least_squares(residual, start, bounds=LOG_RATIO_BOUNDS, xtol=1e-12, ftol=1e-14)
        worst = float(np.max(np.abs(found.fun)))
        if worst > 1e-3:
            k = int(np.argmax(np.abs(found.fun)))
            raise IdentificationError(
                f'{self._name}: damping of {picked[k].coordinate} must explain the measured '
                f'damping ratio {ratios[k]:.4g} at {measured[k]:.4g} Hz, got '
                f'{ratios[k] * np.exp(found.fun[k]):.4g} (other damping in the model?)'
            )
        return np.asarray(np.exp(found.x))

    def _ratios(self, damping: Array, model: Array) -> Array:
        """Return the damping ratios of the modes nearest to those of the undamped model [Hz]."""
        size = len(self._moving)
        first = np.zeros((2 * size, 2 * size))
        first[:size, size:] = np.eye(size)
        first[size:, :size] = -np.linalg.solve(self._mass, self._stiffness)
        first[size:, size:] = -np.linalg.solve(self._mass, np.diag(damping[self._moving]))
        poles = scipy.linalg.eigvals(first)
        poles = poles[poles.imag >= 0.0]
        size_hz = np.maximum(np.abs(poles) / (2.0 * np.pi), 1e-12)
        place = linear_sum_assignment(np.abs(np.log(model[:, None] / size_hz)))[1]
        return np.asarray(-poles[place].real / np.abs(poles[place]))


def configuration(robot: Robot, joints: Mapping[str, float]) -> Array:
    """Return the state (n,) at given joint positions, the amplitudes in equilibrium."""
    unknown = sorted(set(joints) - set(robot.joint_names))
    if unknown:
        raise IdentificationError(
            f'{robot.tree.name}: joints must be some of {", ".join(robot.joint_names)}, '
            f'got {", ".join(unknown)}'
        )
    return measured_equilibrium(robot, np.array([joints.get(n, 0.0) for n in robot.joint_names]))
