"""Tracked numbers of a running node: what the part identification gives, if it is there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from denoc_ros.dynamics.base.base_motion import BaseMotion
from denoc_ros.dynamics.robot import Robot
from denoc_ros.estimation.observer import Observer
from denoc_ros.parts import optional
from denoc_ros.runtime.loop.status import Status
from denoc_ros.runtime.parameters.parameter_table import Settings
from denoc_ros.types import Array

BaseAt = Callable[[float], BaseMotion | None]


class TrackedNumbers(Protocol):
    """Numbers of a robot that are tracked, with their standard deviations."""

    @property
    def paths(self) -> tuple[str, ...]:
        """Dotted paths of the numbers."""

    @property
    def values(self) -> Array:
        """Present values (p,)."""

    @property
    def deviations(self) -> Array:
        """Standard deviations (p,)."""


class Adaptation:
    """Tracks nothing; the part identification extends this class.

    Attributes
    ----------
    tracker : TrackedNumbers or None
        What is tracked.
    fresh : bool
        Whether there is something new to publish since the last `apply`.
    """

    def __init__(self) -> None:
        self.tracker: TrackedNumbers | None = None
        self.fresh = False

    def adopt(self, other: Adaptation) -> None:
        """Go on from another's values, if they are of the same numbers and start."""

    def sense(self, place: int, stamp: float, value: float) -> None:
        """Take a sensor's calibrated value, of a time [s]."""

    def measure(self, stamp: float, q: Array, qd: Array | None, effort: Array | None) -> None:
        """Take the joints (joints,) at a time [s]; None stands for unknown values."""

    def reset(self, values: bool) -> None:
        """Forget the measurements, and with `values` also the found numbers."""

    def apply(self, observer: Observer) -> None:
        """Give the present values to an observer that was built with those of the start."""

    def status(self) -> Status | None:
        """Return the status of the tracking; None if nothing is tracked."""
        return None


def is_tracking(settings: Settings) -> bool:
    """Say whether the parameters of a node name numbers that are tracked."""
    return 'adapt' in settings and bool(settings.texts('adapt'))


def adaptation(
    robot: Robot,
    joints: Sequence[str],
    settings: Settings,
    where: str,
    base: BaseAt | None = None,
) -> Adaptation:
    """Return the tracking of the numbers that the parameters `adapt*` of a node name.

    Parameters
    ----------
    base : callable, optional
        Motion of the base at a time; None: it is at rest.

    Raises
    ------
    ConfigError
        Paths, bounds or a robot that cannot be tracked.
    """
    part = optional('identification.tracking.live_adaptation')
    if part is None:
        return Adaptation()
    found: Adaptation = part.LiveAdaptation(robot, joints, settings, where, base)
    return found
