"""By how much noise of the measured joints pulls a search from the truth.

The joints' motion drives the model, so its noise is in the residuals and in their derivatives by
the parameters alike: scores do not vanish at the truth on average. Noise of the same size once
more on top shows by how much, to first order in its variance (J. R. Cook, L. A. Stefanski, JASA
89, 1994).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from denoc_ros.identification.model.free_parameters import FreeParameters
from denoc_ros.identification.model.prediction import PreparedRun
from denoc_ros.identification.model.robust import bending_slope, bent
from denoc_ros.identification.model.simulated_runs import SimulatedRuns
from denoc_ros.identification.model.whitening import Whitening
from denoc_ros.types import Array

PAIRS = 2  # of draws of the joints' noise
MOST = 0.9  # of the information along a direction that may be noise's


@dataclass(frozen=True)
class JointNoise:
    """Mean effect of additional joint noise on the scores and information of p parameters.

    Attributes
    ----------
    pulls : (pairs, p) array
        What each pair of draws adds to the scores, the derivatives of half the cost.
    lost : (p, p) array
        What they add to J^T J: of the information, what is noise's.

    Notes
    -----
    A search ends where scores s(theta) = A (theta - truth) + pull(theta) vanish, with A = J^T J -
    lost. Its distance from the truth is that of A, -A^-1 pull(theta): where noise is a share v of
    the information, 1 / (1 - v) times what J^T J says.
    """

    pulls: Array
    lost: Array

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


def joint_noise(
    runs: Sequence[PreparedRun],
    parameters: FreeParameters,
    whitening: Whitening,
    simulated: SimulatedRuns,
    theta: Array,
) -> JointNoise:
    """Estimate the effect of joint noise on scores and information at theta (p,).

    Noise comes in pairs of both signs: what is linear in it cancels.
    """
    scores, normal = _at(simulated, whitening, theta)
    pulls, added = np.zeros((PAIRS, len(theta))), np.zeros(normal.shape)
    for k in range(2 * PAIRS):
        draw = np.random.default_rng(k // 2)
        shaken = SimulatedRuns([run.shaken(draw, 1.0 - 2.0 * (k % 2)) for run in runs], parameters)
        more, slopes = _at(shaken, whitening, theta)
        pulls[k // 2] += 0.5 * (more - scores)
        added += (slopes - normal) / (2 * PAIRS)
        simulated.evaluations += shaken.evaluations
    return JointNoise(pulls, bounded(added, normal))


def _at(simulated: SimulatedRuns, whitening: Whitening, theta: Array) -> tuple[Array, Array]:
    """Return scores (p,) and J^T J (p, p)."""
    whitened = whitening(simulated.residuals(theta))
    curve = bending_slope(whitened)
    slopes = curve[:, None] * whitening(simulated.slopes(theta, range(len(theta))))
    return bent(whitened) @ slopes, slopes.T @ slopes


def bounded(added: Array, normal: Array) -> Array:
    """Bound added information along each direction between zero and a share of the whole."""
    values, vectors = np.linalg.eigh(normal)
    kept = values > 1e-12 * max(float(values.max(initial=0.0)), 1e-300)
    root = vectors[:, kept] * np.sqrt(values[kept])
    inverse = vectors[:, kept] / np.sqrt(values[kept])
    share, turned = np.linalg.eigh(inverse.T @ added @ inverse)
    within = root @ turned
    return np.asarray(within * np.clip(share, 0.0, MOST) @ within.T)
