"""How well a blind identification does against the truth: errors, intervals, verdicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from truth_robots import TruthCase
from truth_runs import RELATIVE, TruthRun

from denoc_ros.identification.model.free_parameters import FreeParameters
from denoc_ros.identification.model.model_fit import IdentifiedModel, free_parameters
from denoc_ros.identification.model.prediction import PreparedRun
from denoc_ros.identification.model.search import ModelSearch
from denoc_ros.types import Array

NORMAL = 1.96  # standard deviations of half a 95 % interval
UNTOLD = 0.5  # half an interval, in sizes: what the data cannot tell
CUTOFF, STEP = 20.0, 5e-4  # as `identify_model` has them
ROUNDED = ': readings must vary by more than rounding'
ROUNDING = 16.0 * np.finfo(np.float64).eps  # of a reading: what is computed in another order


@dataclass(frozen=True)
class NumberScore:
    """One number: what was said of it, and what is so.

    Attributes
    ----------
    path, verdict : str
    error : float
        Of the value, in sizes: a share of the true number itself where it must be positive.
    half : float
        Half the interval that was said, in sizes.
    covered : bool
        The truth is inside it.
    limit : float
        Half the interval that the noise alone allows: Cramer and Rao's bound at the truth.
    """

    path: str
    verdict: str
    error: float
    half: float
    covered: bool
    limit: float


def scored(case: TruthCase, run: TruthRun, found: IdentifiedModel) -> list[NumberScore]:
    """Return the score of each free number."""
    parameters = free_parameters(case.robot, case.free, [run.recording])
    theta = true_point(case, parameters)
    truth = parameters.values(theta)
    scales, sizes = parameters.scales(theta), parameters.sizes(theta)
    limits = noise_limits(case, run, parameters) * scales / sizes
    scores = []
    for path, true, size, limit in zip(parameters.paths, truth, sizes, limits, strict=True):
        low, high = found.interval[path]
        scores.append(
            NumberScore(
                path,
                found.verdict[path],
                float(abs(found.values[path] - true) / size),
                float(0.5 * (high - low) / size),
                bool(low <= true <= high),
                float(limit),
            )
        )
    return scores


def silent_gauges(run: TruthRun) -> set[str]:
    """Return the gauges whose true readings, without noise, vary by rounding alone."""
    gauges = {name: raw for name, (_, raw) in run.recording.sensors.items() if raw.ndim == 1}
    return {
        name
        for name, raw in gauges.items()
        if run.noise[name] <= RELATIVE * ROUNDING * float(np.abs(raw).max())
    }


def is_rightly_refused(run: TruthRun, message: str) -> bool:
    """Say whether a refusal names nothing but gauges that show rounding alone, as they do."""
    named, is_by_rounding, _ = message.partition(ROUNDED)
    paths = [path.split('.') for path in named.split(', ')]
    silent = silent_gauges(run)
    return bool(is_by_rounding) and all(
        len(path) == 3 and path[0] == 'sensor' and path[1] in silent for path in paths
    )


def true_point(case: TruthCase, parameters: FreeParameters) -> Array:
    """Return where the truth is (p,), in coordinates that know the recording's sizes."""
    drawn = case.parameters
    values = dict(zip(drawn.paths, drawn.values(case.theta), strict=True))
    theta: Array = parameters.point(values)
    theta[len(drawn.numbers) :] = case.theta[len(drawn.numbers) :]
    return theta


def noise_limits(case: TruthCase, run: TruthRun, parameters: FreeParameters) -> Array:
    """Return half the 95 % interval of each number at the truth (p,), in its scale.

    Of the channels' noise alone, as the one who drew it knows it: no estimator that is unbiased
    has a narrower one. Infinite where nothing is seen.
    """
    prepared = PreparedRun(run.recording, case.robot, CUTOFF, STEP)
    search, theta = ModelSearch([prepared], parameters), true_point(case, parameters)
    search.deviation = np.array([run.noise[name] for _, name, _ in search.labels])
    jacobian = search.jacobian(theta) @ np.linalg.inv(parameters.slopes(theta))
    jacobian = jacobian * parameters.scales(theta)
    values, vectors = np.linalg.eigh(jacobian.T @ jacobian)
    told = values > 1e-12 * values.max()
    variance = np.sum(vectors[:, told] ** 2 / values[told], axis=1)
    blind = np.linalg.norm(vectors[:, ~told], axis=1) > 1e-3
    return np.asarray(np.where(blind, np.inf, NORMAL * np.sqrt(variance)))


def summary(scores: Sequence[NumberScore]) -> dict[str, float]:
    """Return the measures of a campaign.

    Returns
    -------
    dict of str to float
        `numbers`, `found`, `doubtful`: how many; `median_error` of found ones; `coverage` of
        found and of all with an interval; `untold_found`: how many are called found whose limit
        is beyond half their size; `wrong_found`: how many of the found are off by 5 % or more.
    """
    found = [score for score in scores if score.verdict == 'found']
    said = [score for score in scores if np.isfinite(score.half)]
    return {
        'numbers': len(scores),
        'found': len(found),
        'doubtful': sum(score.verdict == 'doubtful' for score in scores),
        'untold': sum(score.limit > UNTOLD for score in scores),
        'median_error': _mean_or_nan(np.median, [score.error for score in found]),
        'coverage': _mean_or_nan(np.mean, [score.covered for score in found]),
        'coverage_all': _mean_or_nan(np.mean, [score.covered for score in said]),
        'untold_found': sum(score.limit > UNTOLD for score in found),
        'wrong_found': sum(score.error > 0.05 for score in found),
    }


def _mean_or_nan(statistic: object, values: Sequence[float]) -> float:
    return float(statistic(values)) if values and callable(statistic) else float('nan')
