"""Springs of elastic joints: forces at a state, and s, s', s'' from the gears' output torque.

Force and torque balance at the gear, f(s) + d s' = -t, whatever the rotor does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.robot_model import Held, RobotModel
from denoc_ros.kernels.jit.compiled import ready
from denoc_ros.kernels.jit.handle import PLAY, STIFFNESS3
from denoc_ros.kernels.springs.link_side_dynamics import elastic_terms
from denoc_ros.model.tree import Spring
from denoc_ros.types import Array


def half_play(robot: RobotModel) -> Array:
    """Return half the backlash (n,) of springs [rad or m], 0 along other coordinates."""
    play: Array = robot.arrays.diagonals[PLAY]
    return play


def spring_indices(robot: RobotModel) -> NDArray[np.intp]:
    """Return the indices of elastic joints' springs among the coordinates."""
    places = robot.arrays.link_map
    if places is None:
        return np.zeros(0, dtype=np.intp)
    return np.asarray(places[0][places[1] == 1], dtype=np.intp)


def elasticity(robot: RobotModel, q: Array) -> tuple[Array, Array]:
    """Return the elastic forces (n,) along the coordinates q (n,), and their derivatives."""
    if not robot.arrays.diagonals[STIFFNESS3 : PLAY + 1].any():
        return robot.stiffness * q, robot.stiffness
    ready(elastic_terms)
    force, slope = np.empty((2, robot.n))
    elastic_terms(robot.handle, np.ascontiguousarray(q, dtype=np.float64), force, slope)
    return force, slope


def with_motors(robot: Held) -> Held:
    """Robot whose kernels leave the torques of all rows in the workspace.

    Of a robot with elastic joints, inverse and forward dynamics else work on its link side.
    """
    if robot.arrays.link_side is None:
        return robot
    other = robot.copy()
    other._adopt(robot.arrays.without_link_side())
    other.constants[:] = robot.constants
    other.move_base(robot.base_motion)
    return other


CUTOFF = 100.0  # Hz, of the filter on the torque
SHARE = 0.1  # of the rate of the updates: at most so much
NEWTON = 20  # steps of the search for a deflection, at most


class GearSprings:
    """Deflections of springs that carry torques, update by update.

    Parameters
    ----------
    cutoff : float
        Bandwidth of the filter on the torques [Hz].

    Attributes
    ----------
    deflection, rate, acceleration : (springs,) arrays
        s = link side - motor side [rad, m], and per s, per s^2.

    Notes
    -----
    A critically damped filter gives t, t' and t''. Its lag is twice its time constant; torque and
    rate are carried on by so much. The balance is then solved implicitly, so that it is stable
    for any damping d.
    """

    def __init__(self, springs: Sequence[Spring], cutoff: float = CUTOFF) -> None:
        self._springs = tuple(springs)
        self._cutoff = cutoff
        self._damping = np.array([spring.damping for spring in springs])
        count = len(self._springs)
        self.deflection, self.rate, self.acceleration = np.zeros((3, count))
        self._torque = np.zeros((2, count))  # filtered, and its rate
        self._started = False

    def reset(self) -> None:
        """Forget all: the next update finds the springs at rest under the torque."""
        self._started = False

    def adopt(self, other: GearSprings) -> None:
        """Go on from the state of as many other springs."""
        self.deflection, self.rate = other.deflection.copy(), other.rate.copy()
        self.acceleration, self._torque = other.acceleration.copy(), other._torque.copy()
        self._started = other._started

    def follow(self, torque: Array, elapsed: float) -> None:
        """Take torques (springs,) [N m, N] in, so long after those before [s]."""
        if not self._started or elapsed <= 0.0:
            still = [deflection(s, -t) for s, t in zip(self._springs, torque, strict=True)]
            self.deflection = np.array(still)
            self.rate, self.acceleration = np.zeros((2, len(still)))
            self._torque = np.array([torque, 0.0 * torque])
            self._started = True
            return
        carried, rate, change = self._filter(torque, elapsed)
        drag = self._damping / elapsed
        pairs = zip(self._springs, self.deflection, -carried, drag, strict=True)
        self.deflection = np.array([next_deflection(*pair) for pair in pairs])
        pairs_of_slope = zip(self._springs, self.deflection, strict=True)
        stiff = drag + np.array([tangent(spring, s) for spring, s in pairs_of_slope])
        self.rate = (drag * self.rate - rate) / stiff
        self.acceleration = (drag * self.acceleration - change) / stiff

    def _filter(self, torque: Array, elapsed: float) -> tuple[Array, Array, Array]:
        """Return torque and rate carried on to now, and how the rate changes."""
        omega = 2.0 * math.pi * min(self._cutoff, SHARE / elapsed)
        t, rate = self._torque
        # implicit, so that it is stable for any elapsed time
        change = omega**2 * (torque - t - elapsed * rate) - 2.0 * omega * rate
        change = change / (1.0 + 2.0 * omega * elapsed + (omega * elapsed) ** 2)
        rate = rate + elapsed * change
        self._torque = np.array([t + elapsed * rate, rate])
        lag = 2.0 / omega
        return self._torque[0] + lag * rate, rate + lag * change, change


def deflection(spring: Spring, force: float) -> float:
    """Return the deflection at which a spring gives a force, beyond the corners of its play."""
    return math.copysign(0.5 * spring.backlash, force) + _wind_up(spring, force) if force else 0.0


def next_deflection(spring: Spring, before: float, force: float, drag: float) -> float:
    """Return the s of f(s) + drag (s - before) = force; without drag that of the force alone.

    Parameters
    ----------
    before : float [rad, m]
    force : float [N m, N]
    drag : float
        Damping over a step [N m/rad, N/m].
    """
    if drag == 0.0:
        return deflection(spring, force)
    loose, play = before + force / drag, 0.5 * spring.backlash
    if abs(loose) <= play:
        return loose
    corner = math.copysign(play, loose)
    return corner + _wind_up(spring, force + drag * (before - corner), drag)


def _wind_up(spring: Spring, force: float, drag: float = 0.0) -> float:
    """Return the e of (k + drag) e + k3 e^3 = force."""
    k, k3 = spring.stiffness + drag, spring.stiffness3
    e = force / k
    for _ in range(NEWTON if k3 > 0.0 else 0):  # from outside: each step comes nearer
        e -= (k * e + k3 * e**3 - force) / (k + 3.0 * k3 * e * e)
    return e


def tangent(spring: Spring, s: float) -> float:
    """Return the stiffness of a spring beyond its play at a deflection."""
    e = max(abs(s) - 0.5 * spring.backlash, 0.0)
    return spring.stiffness + 3.0 * spring.stiffness3 * e * e
