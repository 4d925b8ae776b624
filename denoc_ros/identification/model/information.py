"""Information in the data: covariance, unseen directions, and combinations that are seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from denoc_ros.identification.model.whitening import JointNoise
from denoc_ros.types import Array

Mask = NDArray[np.bool_]

WIDEST_SEEN = 0.5  # half a 95 % interval, in sizes of the parameters: wider is not told
FOUND = 0.05  # the same of one parameter that is found
TOUCHED = 0.05  # component along what is not seen that makes a parameter not identifiable
REACH = 100.0  # sizes that a direction may move by, where data do not tell it at all
ROUNDED = 1e-12  # of the information of the best told direction: less of it is rounding
SMALL = 0.08  # coefficient of a combination that is left out
EXACT = 1e-3  # sizes: what smoothing and the motion between samples leave, beside noise
# the same of a sensor's offset: what they leave swings with the motion, about its mean
EXACT_OFFSET = 1e-4
NOT_TOLD = 'not identifiable'
VERDICTS = 'found', 'doubtful', NOT_TOLD  # from the best to the worst
LISTED = 12  # combinations that are written down


@dataclass(frozen=True)
class Information:
    """Information about p parameters, in units of their sizes."""

    half: Array  # (p,) half the 95 % interval; infinite where not identifiable
    unseen: Array  # (p, u) orthonormal directions that the data do not tell
    # (p, p) what derivatives of half the cost move the estimate by, along what is told
    by_scores: Array

    def widened(self, *scores: Array) -> Information:
        """Return the same with intervals that reach as far as scores (p,) move the estimate."""
        more = sum((np.abs(self.by_scores @ each) for each in scores), np.zeros(len(self.half)))
        return replace(self, half=self.half + more)

    @property
    def touched(self) -> Mask:
        """Parameters in a direction that the data do not tell, (p,) bool."""
        return in_directions(self.unseen)


def in_directions(unseen: Array) -> Mask:
    """Return which parameters (p,) lie in orthonormal directions (p, u)."""
    return np.asarray(np.linalg.norm(unseen, axis=1) > TOUCHED)


def information(
    jacobian: Array,
    residual: Array,
    blocks: NDArray[np.int64],
    drawn: Array | None = None,
    channels: int = 1,
    noise: JointNoise | None = None,
    exact: Array | float = EXACT,
) -> Information:
    """Information from whitened residuals at an estimate whose scores vanish.

    Parameters
    ----------
    jacobian : (m, p) array
        Of the residuals (m,) by the parameters, in sizes of theirs.
    blocks : (m,) int array
        Which stretch of time a row is of: rows of one stretch may hang together as they like.
    drawn : (d, m) array, optional
        Changes of the residuals by noise of what drives the model, drawn d times: links that
        vibrate remember it for longer than a stretch.
    channels : int
        How many rows of a stretch do not hang together.
    noise : JointNoise, optional
        What noise of what drives the model adds to scores and information.
    exact : (p,) array or float
        What is left of each parameter beside noise, in sizes: no interval is narrower.

    Notes
    -----
    The covariance is H^-1 M H^-1 with H = J^T J and M the sum over stretches of g g^T, g = J_b^T
    r_b: right whatever the residuals' colour (K.-Y. Liang, S. L. Zeger, Biometrika 73, 1986). It
    is never less than that of white residuals, and has what the drawn changes do to the estimate
    on top. What noise pulls the estimate by is added to the interval, as far as few draws tell it.
    """
    p = jacobian.shape[1]
    noise = noise or JointNoise(np.zeros((1, p)), np.zeros((p, p)))
    labels, place = np.unique(blocks, return_inverse=True)
    count = len(labels)
    scores = np.zeros((count, p))
    np.add.at(scores, place, jacobian * residual[:, None])
    normal = jacobian.T @ jacobian
    values, vectors = np.linalg.eigh(normal)
    along = scores @ vectors
    independent = channels * count
    freedom = max(independent - p, 5)
    # p numbers that were fitted have taken their share of the residuals with them
    fitted = independent / freedom
    freedom = min(freedom, count - 1)
    meat = np.sum(along**2, axis=0) * fitted
    # colour can only take information away: never less than white residuals would leave
    square = float(np.mean(residual**2))
    meat = np.maximum(meat, values * square)
    shifts = np.zeros((1, p)) if drawn is None else drawn @ jacobian
    meat = meat + np.mean((shifts @ vectors) ** 2, axis=0)
    quantile = float(student.ppf(0.975, freedom))
    resolved = values > ROUNDED * max(values.max(initial=0.0), 1e-300)
    width = np.full(p, REACH)
    width[resolved] = quantile * np.sqrt(meat[resolved]) / values[resolved]
    seen = width < WIDEST_SEEN
    told = vectors[:, seen]
    by_scores = (told / values[seen]) @ told.T
    spread = scores @ by_scores
    white = np.diag(by_scores) * square
    variance = np.maximum(np.sum(spread**2, axis=0) * fitted, white)
    variance += np.mean((shifts @ by_scores) ** 2, axis=0)
    by_pull = told @ np.linalg.solve(told.T @ (normal - noise.lost) @ told, told.T)
    variance += np.mean((noise.left_open @ by_pull) ** 2, axis=0)
    half = np.hypot(quantile * np.sqrt(variance), exact) + np.abs(by_pull @ noise.pull)
    unseen = vectors[:, ~seen]
    # however little of a parameter lies in a direction that is not told, it moves with it
    leak = np.linalg.norm(unseen * np.fmin(width[~seen], REACH), axis=1)
    half = np.hypot(half, leak)
    half[in_directions(unseen)] = np.inf
    return Information(half, unseen, by_scores)


def left_beside_noise(offsets: Mask) -> Array:
    """Error that no number of samples reduces (p,), in sizes."""
    return np.asarray(np.where(offsets, EXACT_OFFSET, EXACT))


def interval_ends(values: Array, half: Array, factors: Mask) -> tuple[Array, Array]:
    """Return the ends (p,) of intervals of half a width; those of factors in logarithms."""
    low, high = values - half, values + half
    own, size = values[factors], np.abs(values[factors])
    with np.errstate(over='ignore', divide='ignore', invalid='ignore'):
        ratio = np.exp(np.where(size > 0.0, half[factors] / size, np.inf))
    low[factors], high[factors] = own / ratio, own * ratio
    return low, high


def verdict_of(half: float) -> str:
    """Return found, doubtful or not identifiable by half an interval as a share of a size."""
    if half <= FOUND:
        return 'found'
    return 'doubtful' if half <= WIDEST_SEEN else NOT_TOLD


def combinations(
    info: Information, names: Sequence[str], factors: Mask, has_effect: Mask | None = None
) -> list[str]:
    """Combinations of parameters that the data tell, though not each parameter alone.

    Parameters
    ----------
    factors : (p,) bool array
        Parameters whose logarithms are combined: products; the others' sums.
    has_effect : (p,) bool array, optional
        Parameters that a measurement can depend on, in some motion; default: all.

    Returns
    -------
    list of str
        Such as `beam.a.y.ei / beam.b.y.ei`, and names that nothing is seen of at all.
    """
    idle = [name for k, name in enumerate(names) if has_effect is not None and not has_effect[k]]
    never = f'no measurement of this robot depends on {", ".join(idle)}, whatever the motion'
    told = _told_together(info, [*names], factors, idle)
    return [*([never] if idle else []), *told][:LISTED]


def _told_together(
    info: Information, names: list[str], factors: Mask, idle: Sequence[str]
) -> list[str]:
    """Return the lines about parameters that have an effect."""
    places = [k for k, touched in enumerate(info.touched) if touched and names[k] not in idle]
    if not places:
        return []
    blind = [names[i] for i in places if np.linalg.norm(info.unseen[i]) > 1.0 - TOUCHED**2]
    mixed = [i for i in places if names[i] not in blind]
    found = [f'nothing is seen of {", ".join(blind)}'] if blind else []
    for row in _seen_rows(info.unseen[mixed]):
        members = [(row[k], names[i], bool(factors[i])) for k, i in enumerate(mixed)]
        members = [member for member in members if abs(member[0]) > SMALL]
        if len(members) > 1:
            found.append(f'only {_text(members)} is seen')
    return found


def _seen_rows(unseen: Array) -> Array:
    """Reduced echelon rows that span the complement of the unseen directions."""
    left, sizes, _ = np.linalg.svd(unseen, full_matrices=True)
    rows: Array = left[:, int(np.sum(sizes > TOUCHED)) :].T.copy()
    pivot = 0
    for column in range(rows.shape[1]):
        if pivot == len(rows):
            break
        best = pivot + int(np.argmax(np.abs(rows[pivot:, column])))
        if abs(rows[best, column]) < TOUCHED:
            continue
        rows[[pivot, best]] = rows[[best, pivot]]
        rows[pivot] /= rows[pivot, column]
        others = np.arange(len(rows)) != pivot
        rows[others] -= np.outer(rows[others, column], rows[pivot])
        pivot += 1
    return rows


def _text(members: Sequence[tuple[float, str, bool]]) -> str:
    if not all(factor for _, _, factor in members):
        terms = [
            f'{"-" if weight < 0.0 else "+"} {abs(weight):.2g} {name}'
            for weight, name, _ in members
        ]
        return ' '.join(terms).removeprefix('+ ')
    above = [_power(weight, name) for weight, name, _ in members if weight > 0.0]
    below = [_power(-weight, name) for weight, name, _ in members if weight < 0.0]
    return ' / '.join([' * '.join(above) or '1', *below])


def _power(weight: float, name: str) -> str:
    return name if abs(weight - 1.0) < SMALL else f'{name}^{weight:.2g}'
