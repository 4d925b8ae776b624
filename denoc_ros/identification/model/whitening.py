"""Residuals of all runs in standard deviations, less their predictable part."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.robot import Robot
from denoc_ros.identification.model.free_parameters import SearchPoint
from denoc_ros.identification.model.innovations import Innovations, LinkedRows
from denoc_ros.identification.model.nearby_motion import NearbyMotion
from denoc_ros.identification.model.prediction import PreparedRun
from denoc_ros.types import Array

WILD = 10.0  # deviations from which a row is an outlier, that no vibration is followed by
UNHEARD = 100.0  # times its deviation is what a filter takes an outlier's for


class Whitening:
    """Whitening of residuals: each channel's deviation, and filters about a motion.

    Parameters
    ----------
    runs : sequence of PreparedRun

    Attributes
    ----------
    deviation : (channels,) array
        Of each channel's own noise.
    channel : (m,) int array
        Of each row.
    """

    def __init__(self, runs: Sequence[PreparedRun]) -> None:
        self._runs = runs
        counts = [len(channel.t) for run in runs for channel in run.channels]
        self.channel: NDArray[np.int64] = np.repeat(np.arange(len(counts)), counts)
        self.deviation: Array = np.ones(len(counts))
        sizes = [sum(len(channel.t) for channel in run.channels) for run in runs]
        edges = np.concatenate([[0], np.cumsum(sizes)])
        self._parts = [slice(int(a), int(b)) for a, b in pairwise(edges)]
        self._linked: list[tuple[PreparedRun, NearbyMotion, LinkedRows, Array]] = []
        self._filters: list[Innovations] = []
        self._whitened: tuple[Array, Array] | None = None  # the last residuals, before and after

    @property
    def is_following(self) -> bool:
        """Whether filters follow the vibration that noise of the joints makes."""
        return bool(self._filters)

    def follow(self, robot: Robot, settings: SearchPoint, nearby: Sequence[NearbyMotion]) -> None:
        """Follow the vibration about these motions from now on; none: about no motion."""
        self._linked = [
            (run, motion, run.linked_rows(robot, settings, motion), run.rate_noise(robot))
            for run, motion in zip(self._runs, nearby, strict=False)
        ]
        self._filters, self._whitened = [], None

    def weigh(self, deviation: Array, residuals: Array) -> None:
        """Take each channel's deviation (channels,) anew; residuals (m,) show outliers."""
        own = deviation[self.channel]
        if self._filters:
            own = np.where(np.abs(self(residuals)) > WILD, UNHEARD * own, own)
        self.deviation, self._whitened = deviation, None
        if not self._linked:
            return
        self._filters = [
            Innovations(motion, rows, own[part], noise, run.recording.t[: len(motion.starts)])
            for (run, motion, rows, noise), part in zip(self._linked, self._parts, strict=True)
        ]

    def __call__(self, values: Array) -> Array:
        """Return residuals (m,), or their derivatives (m, c), in deviations.

        Nobody writes to residuals, or to what this returns of them.
        """
        if values.ndim > 1:
            return self._of(values)
        if self._whitened is None or self._whitened[0] is not values:
            self._whitened = values, self._of(values)
        return self._whitened[1]

    def _of(self, values: Array) -> Array:
        if not self._filters:
            own = self.deviation[self.channel]
            return np.asarray(values / (own if values.ndim == 1 else own[:, None]))
        return np.concatenate(
            [
                each.whitened(values[part])
                for each, part in zip(self._filters, self._parts, strict=True)
            ]
        )
