"""Residuals of all runs in standard deviations, less their predictable part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.robot import Robot
from denoc_ros.identification.model.free_parameters import SearchPoint
from denoc_ros.identification.model.innovations import Innovations, LinkedRows, NearbyMotion
from denoc_ros.identification.model.prediction import PreparedRun
from denoc_ros.identification.model.robust import huber_residual, huber_slope
from denoc_ros.identification.model.simulated_runs import SimulatedRuns
from denoc_ros.types import Array

OUTLIER_SIGMAS = 10.0  # from which a row is an outlier, that no vibration is followed by
UNHEARD = 100.0  # times its deviation is what a filter takes an outlier's for
PAIRS = 2  # of draws of the joints' noise
LARGEST_NOISE_SHARE = 0.9  # of the information along a direction that may be noise's


class Whitening:
    """Whitening of residuals: each channel's deviation, and filters about a motion.

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
        before = {id(motion.transitions): rows for _, motion, rows, _ in self._linked}
        self._linked = [
            (
                run,
                motion,
                # the same linear model: rows hang on its states as before
                before.get(id(motion.transitions)) or run.linked_rows(robot, settings, motion),
                run.rate_noise(robot),
            )
            for run, motion in zip(self._runs, nearby, strict=False)
        ]
        self._filters, self._whitened = [], None

    def weigh(self, deviation: Array, residuals: Array) -> None:
        """Take each channel's deviation (channels,) anew; residuals (m,) show outliers."""
        own = deviation[self.channel]
        if self._filters:
            own = np.where(np.abs(self(residuals)) > OUTLIER_SIGMAS, UNHEARD * own, own)
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


@dataclass(frozen=True)
class JointNoise:
    """Mean effect of additional joint noise on the scores and information of p parameters.

    Notes
    -----
    A search ends where scores s(theta) = A (theta - truth) + pull(theta) vanish, with A = J^T J -
    lost. Its distance from the truth is that of A, -A^-1 pull(theta): where noise is a share v of
    the information, 1 / (1 - v) times what J^T J says.
    """

    # (pairs, p) what each pair of draws adds to the scores, the derivatives of half the cost
    pulls: Array
    lost: Array  # (p, p) what they add to J^T J: of the information, what is noise's

    @property
    def pull(self) -> Array:
        """Mean effect of the noise on the scores (p,)."""
        return np.asarray(self.pulls.mean(axis=0))

    @property
    def left_open(self) -> Array:
        """How far each pair is from the mean, in deviations of the mean (pairs, p)."""
        return np.asarray((self.pulls - self.pull) / np.sqrt(max(len(self.pulls) - 1, 1)))

    def by(self, numbers: Array) -> JointNoise:
        """Return the same by other numbers, by which (p, p) are the derivatives of these."""
        return JointNoise(self.pulls @ numbers, numbers.T @ self.lost @ numbers)


def joint_noise(whitening: Whitening, simulated: SimulatedRuns, theta: Array) -> JointNoise:
    """Estimate the effect of joint noise on scores and information at theta (p,).

    Noise comes in pairs of both signs: what is linear in it cancels. With one sign the derivatives
    change by as much as with the other.
    """
    here = _slopes(whitening, simulated, theta)
    scores, normal = _at(whitening, simulated, theta, here)
    pulls, added = np.zeros((PAIRS, len(theta))), np.zeros(normal.shape)
    for k in range(PAIRS):
        pair = simulated.shaken(theta, np.random.default_rng(k))
        forth = _slopes(whitening, pair[0], theta)
        for shaken, slopes in zip(pair, (forth, 2.0 * here - forth), strict=True):
            more, square = _at(whitening, shaken, theta, slopes)
            pulls[k] += 0.5 * (more - scores)
            added += (square - normal) / (2 * PAIRS)
            simulated.evaluations += shaken.evaluations
    return JointNoise(pulls, bounded(added, normal))


def _slopes(whitening: Whitening, simulated: SimulatedRuns, theta: Array) -> Array:
    slopes_of = simulated.slopes_nearby if simulated.is_linear else simulated.slopes
    return whitening(slopes_of(theta, range(len(theta))))


def _at(
    whitening: Whitening, simulated: SimulatedRuns, theta: Array, slopes: Array
) -> tuple[Array, Array]:
    """Return scores (p,) and J^T J (p, p) of whitened derivatives (m, p)."""
    whitened = whitening(simulated.residuals(theta))
    weighted = huber_slope(whitened)[:, None] * slopes
    return huber_residual(whitened) @ weighted, weighted.T @ weighted


def bounded(added: Array, normal: Array) -> Array:
    """Bound added information along each direction between zero and a share of the whole."""
    values, vectors = np.linalg.eigh(normal)
    kept = values > 1e-12 * max(float(values.max(initial=0.0)), 1e-300)
    root = vectors[:, kept] * np.sqrt(values[kept])
    inverse = vectors[:, kept] / np.sqrt(values[kept])
    share, turned = np.linalg.eigh(inverse.T @ added @ inverse)
    within = root @ turned
    return np.asarray(within * np.clip(share, 0.0, LARGEST_NOISE_SHARE) @ within.T)
