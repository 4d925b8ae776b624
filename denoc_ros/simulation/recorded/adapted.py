"""Numbers of a robot tracked along a recording: the result, and what finds it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from denoc_ros.dynamics.robot import Robot
from denoc_ros.estimation.base_track import BaseRecord
from denoc_ros.simulation.recorded.replay_settings import ReplayPlan, ReplaySettings
from denoc_ros.types import Array

NORMAL = 1.96  # deviations of half a 95 % interval


@dataclass(frozen=True)
class Adapted:
    """Numbers of a robot over the time of a recording."""

    paths: tuple[str, ...]
    start: Array  # (p,) before the first joint state
    bounds: Array  # (p, 2)
    t: Array  # (k,) from the first joint state [s]: at the end of each block that was compared
    # (k, p) in use since then, and their standard deviations
    values: Array
    deviations: Array
    supported: Array  # (p,) bool: whether the data support the last values
    cause: str  # why nothing is tracked at the end; '' if it is
    restarts: int  # gaps that were not integrated over
    failures: int  # states that the model could not go on from
    model_error: float  # error of the rest of the model, as a share of its torques

    @property
    def last(self) -> Array:
        """The last values (p,)."""
        return self.values[-1] if len(self.values) else self.start


class AdaptAlong(Protocol):
    """What tracks numbers along a recording: the part identification has it."""

    @property
    def paths(self) -> tuple[str, ...]:
        """Dotted paths of the numbers; empty: none."""

    def along(
        self,
        robot: Robot,
        plan: ReplayPlan,
        settings: ReplaySettings,
        base: BaseRecord | None = None,
    ) -> Adapted:
        """Return the numbers over the time of a recording."""
