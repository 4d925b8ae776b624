"""Bounds of the elastic state that a robot can have, and the times in which it decays."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.elastic.section import Section
from denoc_ros.dynamics.equilibrium import response
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.springs import spring_indices
from denoc_ros.errors import StateError
from denoc_ros.model.tree import Beam, Body
from denoc_ros.types import Array

# Beyond this share of its length, or this angle, a beam (or segment of one) is not described by
# small deflections: a tip force that bends a cantilever so far turns its tip by 0.75 rad.
DEFLECTION_SHARE = 0.5
LARGEST_ANGLE_RAD = 1.0
STRAIN_FACTOR = 2.0  # Strain beyond so many times the beam's limit is not elastic.
STATIONS = (0.25, 0.5, 0.75, 1.0)  # Shares of a beam's length at which it is checked.
LARGEST = 1e12  # rad, m, and per s: coordinates without another bound must be finite.
ROUNDING = 1e-9  # Smaller squares of frequencies, as a share of the largest, are zero.


class StateBounds:
    """Refuses states whose deflections the robot cannot have.

    Parameters
    ----------
    robot : Robot
        Its workspace is used here only.
    posture : (n,) array
        Coordinates at which the frequencies are found, loops closed.
    free : (f,) int array, optional
        Coordinates that are not given by measured joints; default the amplitudes.

    Attributes
    ----------
    longest_period : float
        Of the vibration of the free coordinates [s]; 0 for a rigid robot.
    decay_time : float
        In which the slowest of these vibrations falls to 1/e [s]; infinite without damping, 0 for
        a rigid robot.

    Notes
    -----
    Rows of a matrix give deflections, slopes, twist and strain at some stations of each beam, the
    amplitudes of reduced links and the springs of joints, each over its bound. Their rates are
    bounded by the highest frequency of the model times the same bounds.
    """

    def __init__(
        self, robot: Robot, posture: Array, free: NDArray[np.int64] | None = None
    ) -> None:
        self._name = robot.tree.name
        self._bounds: list[_Bound] = []
        for body in robot.tree.bodies:
            if body.beam is not None:
                self._bounds += _beam_bounds(robot, body, body.beam)
            elif body.modes is not None:
                for mode, span in enumerate(body.spans.tolist()):
                    what = f'{body.name}: amplitude of mode {mode + 1}'
                    place = robot.amplitudes(body.name).start + mode
                    self._bounds.append(_Bound(what, place, 1.0, DEFLECTION_SHARE * span))
        for index in spring_indices(robot).tolist():
            what = f'{robot.coordinate_names[index]}: spring'
            self._bounds.append(_Bound(what, index, 1.0, LARGEST_ANGLE_RAD, 'rad'))
        # Joints and base have other bounds; here they must be finite.
        for index in np.setdiff1d(np.arange(robot.n), robot.flexible_indices).tolist():
            self._bounds.append(_Bound(robot.coordinate_names[index], index, 1.0, LARGEST))
        self._rows = np.zeros((len(self._bounds), robot.n))
        for row, bound in zip(self._rows, self._bounds, strict=True):
            row[bound.places] = bound.weights / bound.most
        self.longest_period, self.decay_time, self._highest = _vibration(
            robot, posture, robot.flexible_indices if free is None else free
        )
        self._rate_rows = self._rows / self._highest
        self._shares = np.zeros(2 * len(self._bounds))
        self._values, self._rates = self._shares.reshape(2, -1)

    def require(self, q: Array, qd: Array) -> None:
        """Refuse coordinates and rates (n,) that the robot cannot have.

        Raises
        ------
        StateError
            With the link, the value and its bound.
        """
        values, rates = self._values, self._rates
        with np.errstate(all='ignore'):  # Whatever comes must be refused without a warning.
            self._rows.dot(q, out=values)
            self._rate_rows.dot(qd, out=rates)
            # The sum of squares is the quickest to compute; it is NaN where a value is.
            if self._shares.dot(self._shares) <= 1.0:
                return
        for shares, factor, of in ((values, 1.0, ''), (rates, self._highest, 'rate of ')):
            if not (np.abs(shares) <= 1.0).all():
                worst = int(np.argmax(np.where(np.isnan(shares), np.inf, np.abs(shares))))
                bound, share = self._bounds[worst], float(shares[worst])
                most = factor * bound.most
                unit = f'{bound.unit}/s' if of else bound.unit
                raise StateError(
                    f'{self._name}: {of}{bound.what} must be from {-most:.3g} to '
                    f'{most:.3g} {unit}, got {most * share:.3g}'
                )


class _Bound(NamedTuple):
    """The largest magnitude of a weighted sum of coordinates."""

    what: str
    places: slice | int  # of the coordinates
    weights: Array | float
    most: float
    unit: str = ''


def _beam_bounds(robot: Robot, body: Body, beam: Beam) -> Iterator[_Bound]:
    """Yield the bounds of a beam, or of a segment of one."""
    first = robot.amplitudes(body.name).start
    own = slice(first, first + body.amplitudes)
    for share in STATIONS:
        section = Section(beam, share * beam.length, robot.geometric_stiffness)
        at = f'at {body.start + section.station:g} m'
        for component, what, most, unit in (
            (1, 'deflection along y', DEFLECTION_SHARE * beam.length, 'm'),
            (2, 'deflection along z', DEFLECTION_SHARE * beam.length, 'm'),
            (5, 'slope along y', LARGEST_ANGLE_RAD, 'rad'),
            (4, 'slope along z', LARGEST_ANGLE_RAD, 'rad'),
            (3, 'twist', LARGEST_ANGLE_RAD, 'rad'),
        ):
            if section.linear[component].any():
                weights = section.linear[component]
                yield _Bound(f'{body.name}: {what} {at}', own, weights, most, unit)
    for part, surface in zip((beam.y, beam.z), beam.surface, strict=True):
        if part is not None and surface and math.isfinite(beam.strain_limit):
            places = slice(first, first + part.modes)
            stations = beam.length * np.array([0.0, *STATIONS])
            rows = surface * part.shapes.curvatures(stations)
            for station, row in zip(stations.tolist(), rows, strict=True):
                what = f'{body.name}: strain at {body.start + station:g} m'
                yield _Bound(what, places, row, STRAIN_FACTOR * beam.strain_limit)
        first += 0 if part is None else part.modes


def _vibration(
    robot: Robot, posture: Array, free: NDArray[np.int64]
) -> tuple[float, float, float]:
    """Return the longest period [s], the longest decay time [s] and the highest frequency [rad/s].

    The period and the time are those of the free coordinates, the frequency that of the robot
    with its joints free as well: it is the higher one.
    """
    index = robot.flexible_indices
    if not len(index):
        return 0.0, 0.0, 1.0
    root, damping = np.sqrt(robot.stiffness[index]), robot.damping[index]

    def squares_of(moving: NDArray[np.int64]) -> tuple[Array, Array]:
        among = np.searchsorted(moving, index)
        mobility = response(robot, posture, moving)[np.ix_(among, among)]
        found = np.linalg.eigh(root[:, None] * mobility * root)
        return found[0], found[1]

    squares, shapes = squares_of(free)
    highest = math.sqrt(squares_of(np.arange(robot.n))[0][-1])
    moves = squares > ROUNDING * squares[-1]  # Loops hold the other combinations.
    squares, shapes = squares[moves], shapes[:, moves]
    fading = squares * np.einsum('ij,i,ij->j', shapes, damping / root**2, shapes)  # 2 zeta omega
    slowest = float(fading.min())
    decay_time = 2.0 / slowest if slowest > 0.0 else math.inf
    return 2.0 * math.pi / math.sqrt(squares[0]), decay_time, max(highest, 1.0)
