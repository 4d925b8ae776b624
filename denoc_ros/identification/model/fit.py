"""The whole model by maximum likelihood over all channels of all recordings at once.

Each channel's residuals count by their own standard deviation, which the fit finds as well; few
that are far off do not count as squares (Huber's loss). What the data do not tell stays where the
robot has it: a prior of width exp(+-0.5) is part of the search and of no interval.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import DenocError, IdentificationError
from denoc_ros.identification.model.free_parameters import PRIOR, FreeParameters
from denoc_ros.identification.model.information import (
    Information,
    combinations,
    information,
    verdict_of,
)
from denoc_ros.identification.model.prediction import PreparedRun
from denoc_ros.identification.model.recording import Recording, read_recording
from denoc_ros.types import Array

Source = Recording | str | Path

HUBER = 2.5  # standard deviations from which a residual counts linearly
STEP = 1e-4  # of the differences by theta
ROUNDS = 6  # of weights by the residuals' own deviation
SETTLED = 0.03  # change of a deviation that needs no other round
LOST = 1e6  # standard deviations that a robot which cannot be is off by
GROWING = (0.08, 0.2, 0.45)  # parts of the runs that a flexible robot is first fitted to
FEWEST_ROWS = 25  # of each channel in such a part
STRETCHES = 60  # of time, whose residuals are independent of each other
HELD_OUT = 0.25
UNEXPLAINED = 0.1  # of a channel: the model is not what made it
NEGLIGIBLE = 0.02  # of a channel: so little may be left of a held-out part
WORSE = 1.5  # times the rms of what was fitted: a held-out part that is not explained


@dataclass(frozen=True)
class ChannelFit:
    """What a channel's residuals are, rms in its unit: over what was fitted, and held out.

    `size` is the channel's own deviation, `louder` how much more it moves while it is held out.
    """

    run: str
    name: str
    unit: str
    samples: int
    size: float
    louder: float
    before: float
    after: float
    held_out_before: float
    held_out_after: float


@dataclass(frozen=True)
class IdentifiedModel:
    """A robot's numbers as data tell them.

    Attributes
    ----------
    values, start : dict of str to float
        By dotted path; `link.<link>.*` about the link frame's origin.
    interval : dict of str to (float, float)
        95 %; without end where not identifiable.
    verdict : dict of str to str
        found (within 5 %), doubtful (within 50 %) or not identifiable.
    combinations : list of str
        What the data tell of parameters that are not identifiable one by one.
    channels : tuple of ChannelFit
    reasons : tuple of str
        Why values that were found are doubtful.
    overrides : dict of str to number or list
        Of the robot, what was found or doubtful.
    robot : Robot
        With all values.
    seconds : float
    evaluations : int
        Of the model along all recordings.
    """

    values: dict[str, float]
    start: dict[str, float]
    interval: dict[str, tuple[float, float]]
    verdict: dict[str, str]
    combinations: list[str]
    channels: tuple[ChannelFit, ...]
    reasons: tuple[str, ...]
    overrides: dict[str, float | list[float]]
    robot: Robot
    seconds: float
    evaluations: int


def identify_model(
    robot: Robot,
    recordings: Source | Sequence[Source],
    free: Sequence[str],
    *,
    cutoff: float = 20.0,
    held_out: float = HELD_OUT,
    step: float = 2e-3,
) -> IdentifiedModel:
    """Return a robot's numbers by maximum likelihood over what was recorded.

    Parameters
    ----------
    robot : Robot
        Where the search starts.
    recordings : path, Recording, or a sequence of them
        Runs with joint positions and measured effort, gauges or other sensors of the model.
    free : sequence of str
        Dotted paths with `*`: see :class:`FreeParameters`.
    cutoff : float
        Of what is compared of effort [Hz]; the joints' motion is smoothed at twice that.
    held_out : float
        Last part of each run that a first fit does not see, and is judged by; 0: none.
    step : float
        Longest step of the amplitudes' integration [s].

    Returns
    -------
    IdentifiedModel

    Raises
    ------
    ConfigError
        A path that is of nothing.
    BagError, IdentificationError
        A recording that cannot be read, or has too little.
    """
    if not 0.0 <= held_out < 1.0:
        raise IdentificationError(f'held_out must be in [0, 1), got {held_out}')
    began = time.perf_counter()
    given = [recordings] if isinstance(recordings, Source) else list(recordings)
    if not given:
        raise IdentificationError('identify model: recordings must be given, got none')
    whole = [r if isinstance(r, Recording) else read_recording(r, robot) for r in given]
    runs = [PreparedRun(recording, robot, cutoff, step) for recording in whole]
    parameters = FreeParameters(robot, free, _largest_efforts(whole))
    search = _Search(runs, parameters)
    zero = np.zeros(parameters.size)
    start = zero
    if held_out:
        start = search.fit(zero, search.rows_before(1.0 - held_out))
    held = ~search.rows_before(1.0 - held_out)
    fitted = [search.rms(theta, ~held) for theta in (zero, start)]
    judged = [search.rms(theta, held) for theta in (zero, start)]
    theta = search.fit(start, np.ones(len(search.row_t), dtype=bool))
    sides = zip(search.sizes, search.louder(held), *fitted, *judged, strict=True)
    channels = tuple(
        ChannelFit(*label, int(samples), *map(float, row))
        for label, samples, row in zip(search.labels, search.counts, sides, strict=True)
    )
    return _concluded(search, theta, channels, time.perf_counter() - began)


def _largest_efforts(recordings: Sequence[Recording]) -> dict[str, float]:
    found: dict[str, float] = {}
    for recording in recordings:
        for name, column in zip(recording.joints, recording.effort.T, strict=True):
            seen = column[np.isfinite(column)]
            if len(seen):
                found[name] = max(found.get(name, 0.0), float(np.abs(seen).max()))
    return {name: size for name, size in found.items() if size > 0.0}


def root_mean_square(values: Array) -> float:
    """Return the root of the mean of squares."""
    return float(np.sqrt(np.mean(values**2)))


def _bent(residual: Array) -> Array:
    """Return residuals whose squares are Huber's loss."""
    size = np.abs(residual)
    far = size > HUBER
    bent: Array = residual.copy()
    bent[far] = np.sign(residual[far]) * np.sqrt(HUBER * (2.0 * size[far] - HUBER))
    return bent


def _slope(residual: Array) -> Array:
    """Return the derivative of bent residuals by the straight ones."""
    size = np.maximum(np.abs(residual), HUBER)
    slope: Array = HUBER / np.sqrt(HUBER * (2.0 * size - HUBER))
    return slope


class _Search:
    """Residuals of all runs by theta, their weights, and the search over them."""

    def __init__(
        self,
        runs: Sequence[PreparedRun],
        parameters: FreeParameters,
    ) -> None:
        self.parameters, self._runs = parameters, runs
        channels = [(run, channel) for run in runs for channel in run.channels]
        self.labels = [(run.name, channel.name, channel.unit) for run, channel in channels]
        self.counts = np.array([len(channel.t) for _, channel in channels])
        self._channel = np.repeat(np.arange(len(channels)), self.counts)
        self.row_t = np.concatenate([channel.t for _, channel in channels])
        ends = [(run.recording.t[0], run.recording.t[-1]) for run, _ in channels]
        first, last = (np.repeat(np.array(side), self.counts) for side in zip(*ends, strict=True))
        self._part = (self.row_t - first) / (last - first)
        per_run = max(2, STRETCHES // len(runs))
        stretch = np.minimum((self._part * per_run).astype(np.int64), per_run - 1)
        number = {id(run): k for k, run in enumerate(runs)}
        of_run = np.repeat([number[id(run)] for run, _ in channels], self.counts)
        self.blocks = of_run * per_run + stretch
        self._measured = np.concatenate([channel.value for _, channel in channels])
        self.evaluations = 0
        self.deviation = np.ones(len(channels))
        self._until = 1.0
        self._last: tuple[bytes, float, Array] | None = None

    def rows_before(self, part: float) -> NDArray[np.bool_]:
        """Return which rows are in the first part of their run."""
        return np.asarray(self._part <= part)

    @property
    def sizes(self) -> Array:
        """The deviation of each channel's measured values."""
        return self._by_channel(self._measured, np.ones(len(self._measured), dtype=bool), np.std)

    def louder(self, held: NDArray[np.bool_]) -> Array:
        """Return by how much each channel moves more over held-out rows than over the others."""
        sides = [self._by_channel(self._measured, rows, np.std) for rows in (held, ~held)]
        ratio: Array = sides[0] / np.maximum(sides[1], 1e-300)
        return ratio

    def residuals(self, theta: Array) -> Array:
        """Return all residuals in the units of their channels; not finite: no such robot."""
        key = (theta.tobytes(), self._until)
        if self._last is not None and self._last[:2] == key:
            return self._last[2]
        self.evaluations += 1
        settings, until = self.parameters.settings(theta), self._until
        try:
            robot = self.parameters.robot_at(settings)
            parts = [each for run in self._runs for each in run.residuals(robot, settings, until)]
        except DenocError:
            return np.full(len(self.row_t), np.nan)
        self._last = (*key, np.concatenate(parts))
        return self._last[2]

    def rms(self, theta: Array, rows: NDArray[np.bool_]) -> Array:
        """Return the rms of each channel's residuals over some rows, NaN where it has none."""
        return self._by_channel(self.residuals(theta), rows, root_mean_square)

    def _by_channel(
        self, values: Array, rows: NDArray[np.bool_], statistic: Callable[[Array], Any]
    ) -> Array:
        """Return a statistic of each channel's values over some rows, NaN where it has none."""
        found = np.full(len(self.labels), np.nan)
        for k in range(len(self.labels)):
            own = values[rows & (self._channel == k)]
            if len(own):
                found[k] = statistic(own)
        return found

    def whitened(self, theta: Array) -> Array:
        """Return all residuals in their deviations; far off where there is no such robot."""
        found = self.residuals(theta) / self.deviation[self._channel]
        return np.where(np.isfinite(found), found, LOST)

    def fit(self, theta: Array, rows: NDArray[np.bool_]) -> Array:
        """Return the theta of the greatest likelihood over some rows.

        Flexible robots are fitted to the first part of each run before the whole: a mode that
        rings at a wrong frequency is out of phase later on, and leads astray.
        """
        for part in GROWING if len(self.parameters.robot.flexible_indices) else ():
            early = rows & self.rows_before(part)
            if not self._is_enough(early):
                continue
            self._until = part
            self._reweigh(theta, early)
            theta = self._least_squares(theta, early)
        self._until = 1.0
        self._reweigh(theta, rows)
        for _ in range(ROUNDS):
            theta = self._least_squares(theta, rows)
            before = self.deviation.copy()
            self._reweigh(theta, rows)
            if np.nanmax(np.abs(self.deviation / before - 1.0)) < SETTLED:
                break
        return theta

    def _is_enough(self, rows: NDArray[np.bool_]) -> bool:
        """Say whether each channel has rows for a fit of its own."""
        counts = np.bincount(self._channel[rows], minlength=len(self.labels))
        return bool((counts >= FEWEST_ROWS).all())

    def _reweigh(self, theta: Array, rows: NDArray[np.bool_]) -> None:
        """Take each channel's deviation from its residuals, outliers held to Huber's bound."""
        residual = self.residuals(theta)
        if not np.isfinite(residual).all():
            raise IdentificationError(
                'identify model: the robot must be able to make the recorded motion, got a model '
                'that cannot'
            )
        size = self._by_channel(residual, rows, lambda x: 1.48 * np.median(np.abs(x)))
        clipped = np.minimum(np.abs(residual), HUBER * size[self._channel])
        size = self._by_channel(clipped, rows, root_mean_square)
        self.deviation = np.where(size > 0.0, size, 1.0)

    def jacobian(self, theta: Array) -> Array:
        """Return the derivatives of the whitened residuals by theta (m, p).

        Torque that is linear in its numbers by the regressor, all else by differences.
        """
        parameters = self.parameters
        linear, paths = parameters.linear
        slopes = parameters.slopes(theta)
        found, here = np.empty((len(self.row_t), parameters.size)), self.whitened(theta)
        if linear:
            settings = parameters.settings(theta)
            robot = parameters.robot_at(settings)
            self.evaluations += 1
            by_numbers = np.concatenate(
                [run.torque_slopes(robot, paths, run.gains(settings)) for run in self._runs]
            )
            found[:, linear] = by_numbers @ slopes[np.ix_(linear, linear)]
            found[:, linear] /= self.deviation[self._channel][:, None]
        for k in sorted(set(range(parameters.size)) - set(linear)):
            change = np.zeros(parameters.size)
            change[k] = STEP
            found[:, k] = (self.whitened(theta + change) - here) / STEP
        return found

    def _least_squares(self, theta: Array, rows: NDArray[np.bool_]) -> Array:
        count = int(rows.sum())

        prior = np.eye(len(theta)) / PRIOR

        def function(x: Array) -> Array:
            return np.concatenate([_bent(self.whitened(x)[rows]), x / PRIOR])

        def jacobian(x: Array) -> Array:
            weights = _slope(self.whitened(x)[rows])
            return np.concatenate([weights[:, None] * self.jacobian(x)[rows], prior])

        found = least_squares(
            function, theta, jacobian, method='trf', x_scale=1.0, xtol=1e-5, ftol=1e-6,
            gtol=1e-8 * count, max_nfev=40,
        )  # fmt: skip
        return np.asarray(found.x)

    def information(self, theta: Array) -> Information:
        """Return what the data alone tell of the reported numbers, in sizes of theirs."""
        whitened = self.whitened(theta)
        residual, jacobian = _bent(whitened), self.jacobian(theta)
        jacobian *= _slope(whitened)[:, None]
        by_numbers = jacobian @ np.linalg.inv(self.parameters.slopes(theta))
        return information(by_numbers * self.parameters.scales(theta), residual, self.blocks)


def _concluded(
    search: _Search, theta: Array, channels: tuple[ChannelFit, ...], seconds: float
) -> IdentifiedModel:
    parameters = search.parameters
    info = search.information(theta)
    values, scales = parameters.values(theta), parameters.scales(theta)
    reasons = tuple(
        f'{one.run}: {one.name}: what the model leaves must be below a tenth of what is measured '
        f'({one.size:.3g} {one.unit}), got {one.after:.3g}'
        for one in channels
        if one.after > UNEXPLAINED * one.size
    ) + tuple(
        f'{one.run}: {one.name}: held-out rms must be near that of the fit '
        f'({one.after:.3g} {one.unit}), got {one.held_out_after:.3g}'
        for one in channels
        if one.held_out_after
        > max(WORSE * one.after * max(1.0, one.louder), NEGLIGIBLE * one.size)
    )
    verdicts = [verdict_of(half) for half in info.half]
    verdicts = ['doubtful' if reasons and v == 'found' else v for v in verdicts]
    half = info.half * scales
    low, high = values - half, values + half
    factors = parameters.multiplicative
    with np.errstate(over='ignore'):
        ratio = np.exp(np.where(values != 0.0, half / np.abs(values), np.inf))
    low[factors], high[factors] = (
        values[factors] / ratio[factors],
        values[factors] * ratio[factors],
    )
    settings = parameters.settings(theta)
    told = {path for path, v in zip(parameters.paths, verdicts, strict=True) if v[0] != 'n'}
    return IdentifiedModel(
        _by_path(parameters, values),
        _by_path(parameters, parameters.values(np.zeros(parameters.size))),
        {p: (float(a), float(b)) for p, a, b in zip(parameters.paths, low, high, strict=True)},
        dict(zip(parameters.paths, verdicts, strict=True)),
        combinations(info, parameters.paths, factors),
        channels,
        reasons,
        {
            path: value
            for path, value in settings.overrides.items()
            if path in told or any(each.startswith(f'{path}.') for each in told)
        },
        parameters.robot_at(settings),
        seconds,
        search.evaluations,
    )


def _by_path(parameters: FreeParameters, values: Array) -> dict[str, float]:
    return {path: float(v) for path, v in zip(parameters.paths, values, strict=True)}
