"""The search for the theta of greatest likelihood: residuals of all runs and their weights."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from denoc_ros.errors import IdentificationError
from denoc_ros.identification.model.free_parameters import PRIOR, FreeParameters
from denoc_ros.identification.model.information import Information, information, left_beside_noise
from denoc_ros.identification.model.prediction import PreparedRun
from denoc_ros.identification.model.robust import (
    HUBER,
    held_rms,
    huber_residual,
    huber_slope,
    root_mean_square,
)
from denoc_ros.identification.model.simulated_runs import STEP, SimulatedRuns
from denoc_ros.identification.model.whitening import JointNoise, Whitening, joint_noise
from denoc_ros.simulation.recorded.plausibility import effort_doubts
from denoc_ros.types import Array

COARSE = 1e-3  # of the cost: a fit goes on while it falls by more, before weights are settled
FINE = 1e-5  # the same of the last one
ROUNDS = 12  # of weights by the residuals' own deviation
# evaluations of a fit before weights are taken anew, and at most
BETWEEN, MOST_EVALUATIONS = 5, 40
# of theta: a step from a point that fewer samples gave, from which no other step is needed, and
# how many there are at most
SHORT_STEP, FEW_STEPS = 0.3, 4
LAST = 12  # the same of a fit by simulated derivatives
STILL_CHANGE = 1e-4  # change of theta that needs no other round
SAME_FILTER = 1e-3  # change of theta with which a filter stays
SETTLED = 0.03  # change of a deviation that needs no other round
LOST = 1e6  # standard deviations that a robot which cannot be is off by
GROWING = (0.08, 0.2, 0.45)  # parts of the runs that a flexible robot is first fitted to
SETTLING = 5  # fits by simulated derivatives, weights and filters taken anew where they end
FEWEST_ROWS = 25  # of each channel in such a part
DRAWS = 24  # of the joints' noise, for the intervals
TOGETHER = 8  # draws whose motions are worked out in one go
ROUNDING = 1e-5  # of a channel's largest value: nothing that varies less is a signal
QUIETEST = 1e-4  # of what a sensor measures: no channel is taken to be more exact
PASSES = 6  # of deviations by what filters leave
FASTEST = 4.0  # times a deviation changes at most in a pass
STRETCHES = 60  # of time, whose residuals are independent of each other
SCANNED = (0.1, 0.2, 0.45, 1.0)  # parts of the runs, the first with enough rows
SIZES = np.arange(-3.0, 3.25, 0.5)  # logarithms of factors on all stiffnesses
STEPS = (2.0, 1.0, 0.5)  # the same, tried on each either way
SWEEPS = 3  # over all of them, at most
CLEARER = 0.1  # mean logarithm of rms by which another size must fit better than the start
FURTHER = 1.0  # logarithm of a factor: a search finds what is nearer by itself


def vector_of(name: str) -> str:
    """Return the vector that a channel is one axis of: `imu/gyro` of `imu/gyro_x`."""
    sensor, slash, part = name.partition('/')
    kind = part.partition('_')[0] if '_' in part else part.rstrip('xyz')
    return f'{sensor}{slash}{kind}'


def is_stiffness(path: str) -> bool:
    """Say whether a number is a rigidity of a beam or a stiffness of a joint."""
    return path.rpartition('.')[2] in ('ei', 'gj', 'stiffness')


class ModelSearch:
    """Residuals of all runs by theta, their weights, and the search over them."""

    def __init__(self, runs: Sequence[PreparedRun], parameters: FreeParameters) -> None:
        self.parameters, self._runs = parameters, runs
        channels = [(run, channel) for run in runs for channel in run.channels]
        self.labels = [(run.name, channel.name, channel.unit) for run, channel in channels]
        self.counts = np.array([len(channel.t) for _, channel in channels])
        self.whitening = Whitening(runs)
        self._channel = self.whitening.channel
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
        self._least = QUIETEST * self._vector_sizes()
        self._simulated = SimulatedRuns(runs, parameters)
        self._is_followed = self._simulated.is_followed
        self._drawn: tuple[bytes, Array] | None = None
        self._is_exact = False

    @property
    def evaluations(self) -> int:
        """How many times the model went along all recordings."""
        return self._simulated.evaluations

    @property
    def has_several_runs(self) -> bool:
        """Whether more than one recording is fitted."""
        return len(self._runs) > 1

    @property
    def deviation(self) -> Array:
        """Unit of each channel's residuals, (channels,)."""
        return self.whitening.deviation

    @deviation.setter
    def deviation(self, value: Array) -> None:
        self.whitening.weigh(value, self._measured)

    def rows_before(self, part: float) -> NDArray[np.bool_]:
        """Return which rows are in the first part of their run."""
        return np.asarray(self._part <= part)

    @property
    def sizes(self) -> Array:
        """Size that each channel's residuals are compared with."""
        return np.array([channel.size for run in self._runs for channel in run.channels])

    def _vector_sizes(self) -> Array:
        """Return the largest deviation of the axes that each channel is one of."""
        vectors = [(run, vector_of(name)) for run, name, _ in self.labels]
        largest: dict[tuple[str, str], float] = {}
        every = np.ones(len(self._measured), dtype=bool)
        # what a constant channel shows beside its constant is rounding
        peaks = self._by_channel(np.abs(self._measured), every, np.max)
        for vector, size in zip(vectors, np.maximum(self.sizes, ROUNDING * peaks), strict=True):
            largest[vector] = max(largest.get(vector, 0.0), float(size))
        return np.array([largest[vector] for vector in vectors])

    def louder(self, held: NDArray[np.bool_]) -> Array:
        """Return by how much each channel moves more over held-out rows than over the others."""
        sides = [self._by_channel(self._measured, rows, np.std) for rows in (held, ~held)]
        ratio: Array = sides[0] / np.maximum(sides[1], 1e-300)
        return ratio

    def residuals(self, theta: Array) -> Array:
        """Return all residuals in the units of their channels; not finite: no such robot."""
        return self._simulated.residuals(theta)

    def effort_doubts(self, theta: Array) -> list[str]:
        """Return in words why measured efforts are not the torques of the joints."""
        residuals, found = self.whole_residuals(theta), []
        if not np.isfinite(residuals).all():
            return []
        settings, first = self.parameters.settings(theta), 0
        parts = np.split(residuals, np.cumsum(self.counts)[:-1])
        for run in self._runs:
            last = first + len(run.channels)
            if run.effort_joints:
                offsets = settings.of_run(run.name).offsets
                sizes = run.effort_sizes(parts[first:last], offsets)
                doubts = effort_doubts(run.effort_joints, sizes)
                found += [f'{run.name}: {doubt}' for doubt in doubts]
            first = last
        return found

    def whole_residuals(self, theta: Array) -> Array:
        """Return the same over whole runs, whatever part of them was fitted last."""
        self._simulated.until = 1.0
        return self.residuals(theta)

    def rms(self, residuals: Array, parts: Sequence[NDArray[np.bool_]]) -> list[Array]:
        """Return the rms of each channel's residuals (m,) over parts of the rows.

        It is NaN where a part has none. Wild values are held to a bound that no vibration reaches.
        """
        return [self._by_channel(residuals, rows, held_rms) for rows in parts]

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
        residuals = self.residuals(theta)
        if not np.isfinite(residuals).all():
            return np.full(len(residuals), LOST)
        return self.whitening(residuals)

    def stiffnesses(self) -> dict[str, float]:
        """Return stiffnesses of about the right size by path, none where the start has it.

        Notes
        -----
        All together first, then one by one. The rows are the first of each run, where a mode of a
        wrong frequency is not yet out of phase: there the likelihood has one maximum over decades.
        Each channel counts by the logarithm of its rms (the likelihood with its best deviation).
        """
        zero, paths = np.zeros(self.parameters.size), self.parameters.paths
        places = [k for k, path in enumerate(paths) if is_stiffness(path)]
        part = next((part for part in SCANNED if self._is_enough(self.rows_before(part))), None)
        if part is None or not places:
            return {}
        rows, self._simulated.until = self.rows_before(part), part
        start = self._misfit(zero, rows)
        best, least = zero, start

        def attempt(theta: Array) -> bool:
            nonlocal best, least
            found = self._misfit(theta, rows)
            if found >= least:
                return False
            best, least = theta, found
            return True

        for size in SIZES:
            theta = zero.copy()
            theta[places] = size
            attempt(theta)
        for _ in range(SWEEPS if len(places) > 1 else 1):
            before = least
            for k, step in product(places, STEPS):
                change = step * np.eye(len(zero))[k]
                if not attempt(best + change):
                    attempt(best - change)
            if least == before:
                break
        is_clear = start - least > CLEARER and np.abs(best).max() >= FURTHER
        values = self.parameters.values(best)
        return {paths[k]: float(values[k]) for k in places if best[k]} if is_clear else {}

    def _misfit(self, theta: Array, rows: NDArray[np.bool_]) -> float:
        """Return the mean logarithm of the channels' rms over some rows; inf: no such robot."""
        residual = self.residuals(theta)
        if not np.isfinite(residual).all():
            return np.inf
        rms = np.maximum(self._by_channel(residual, rows, held_rms), self._least)
        counts = np.bincount(self._channel[rows], minlength=len(rms))
        return float(counts @ np.log(rms) / counts.sum())

    def approach(self, theta: Array, end: float) -> Array:
        """Return a theta near the greatest likelihood over the runs up to a part of them.

        Flexible robots are fitted to the first part of each run before the whole: a mode that
        rings at a wrong frequency is out of phase later on, and leads astray. Where runs have
        more samples than that needs, fewer serve, and steps from there come near with all.
        """
        robot, rows = self.parameters.robot, self.rows_before(end)
        every = min(run.spare_samples(robot) for run in self._runs) if self._is_followed else 1
        if every > 1:
            coarse = ModelSearch(
                [run.coarser(robot, every) for run in self._runs], self.parameters
            )
            theta = coarse._grown(theta, end)
            theta = coarse.fit(theta, coarse.rows_before(end), rough=True)
            for _ in range(FEW_STEPS):
                self._reweigh(theta, rows)
                step = self._newton_step(theta, rows)
                theta = theta + step
                if np.abs(step).max() < SHORT_STEP:
                    break
            return theta
        if len(robot.flexible_indices):
            theta = self._grown(theta, end)
        return theta if end == 1.0 else self.fit(theta, rows, rough=True)

    def _grown(self, theta: Array, end: float) -> Array:
        """Return the theta of the greatest likelihood over early parts, one after the other."""
        for part in (part for part in GROWING if part < end):
            early = self.rows_before(part)
            if self._is_enough(early):
                self._simulated.until = part
                self._reweigh(theta, early)
                theta = self._least_squares(theta, early, COARSE)
        return theta

    def _newton_step(
        self, theta: Array, rows: NDArray[np.bool_], centre: Array | float = 0.0
    ) -> Array:
        """Return the change of theta to the greatest likelihood over some rows, to first order.

        The prior is about a centre (p,).
        """
        residual = self.whitened(theta)[rows]
        weights = huber_slope(residual)
        slopes = weights[:, None] * self.jacobian(theta)[rows]
        design = np.concatenate([slopes, np.eye(len(theta)) / PRIOR])
        wanted = np.concatenate([weights * residual, (theta - centre) / PRIOR])
        return np.asarray(-np.linalg.lstsq(design, wanted)[0])

    def fit(self, theta: Array, rows: NDArray[np.bool_], rough: bool = False) -> Array:
        """Return the theta of the greatest likelihood over some rows, from one that is near.

        A rough fit ends where another would move the numbers by less than their noise does.
        """
        self._simulated.until = 1.0 if rows.all() else float(self._part[rows].max())
        self._is_exact = False
        self._reweigh(theta, rows)
        if self._is_followed:
            return self._fit_followed(theta, rows, rough)
        for _ in range(ROUNDS):
            before, last = self.deviation.copy(), theta
            theta = self._least_squares(theta, rows, COARSE, BETWEEN)
            self._reweigh(theta, rows)
            is_still = np.abs(theta - last).max() < STILL_CHANGE
            if is_still or np.nanmax(np.abs(self.deviation / before - 1.0)) < SETTLED:
                break
        return self._least_squares(theta, rows, FINE)

    def _fit_followed(self, theta: Array, rows: NDArray[np.bool_], rough: bool) -> Array:
        """Return the same where filters follow the vibration: they are made anew where it moves.

        Derivatives by the linear model of the amplitudes are a quarter off near the sampling
        rate, and a search by them ends beside its goal: there it ends by simulated ones.
        """
        for _ in range(ROUNDS):
            before, last = self.deviation.copy(), theta
            theta = self._least_squares(theta, rows, COARSE, BETWEEN)
            is_still = self._is_still(last, theta)
            if is_still and rough:
                return theta
            self._reweigh(theta, rows)
            if is_still and np.abs(self.deviation / before - 1.0).max() < SETTLED:
                break
        if rough or self._simulated.is_linear:
            return self._least_squares(theta, rows, FINE)
        self._is_exact = True
        for _ in range(SETTLING):
            last = theta
            theta = self._least_squares(theta, rows, FINE, LAST)
            if self._is_still(last, theta):
                break
            self._reweigh(theta, rows)  # what is white at one point is not far from it
        return theta

    def _is_still(self, last: Array, theta: Array) -> bool:
        """Say whether the residuals hardly change from one theta to another."""
        moved = self.jacobian(theta) @ (theta - last)
        return bool(moved @ moved < len(theta))

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
        if not self._is_followed:
            self.deviation = self._own_size(residual, rows)
            return
        if not self.whitening.is_following:
            quietest = [each for run in self._runs for each in run.quietest()]
            self._least = np.maximum(self._least, quietest)
            self.whitening.deviation = self._least
        settings = self.parameters.settings(theta)
        robot, _ = self._simulated.moved(settings)
        self.whitening.follow(robot, settings, self._simulated.linear_motions(theta, SAME_FILTER))
        deviation = self.deviation
        for _ in range(PASSES):
            self.whitening.weigh(deviation, residual)
            left = self._own_size(self.whitening(residual), rows, 0.0)
            before = deviation
            deviation = np.maximum(deviation * np.clip(left, 1.0 / FASTEST, FASTEST), self._least)
            if np.abs(deviation / before - 1.0).max() < SETTLED:
                break
        self.whitening.weigh(deviation, residual)

    def _own_size(
        self, residual: Array, rows: NDArray[np.bool_], least: Array | float | None = None
    ) -> Array:
        """Return each channel's deviation, outliers held to Huber's bound."""
        size = self._by_channel(residual, rows, lambda x: 1.48 * np.median(np.abs(x)))
        clipped = np.minimum(np.abs(residual), HUBER * size[self._channel])
        size = self._by_channel(clipped, rows, root_mean_square)
        size = np.maximum(size, self._least if least is None else least)
        return np.where(size > 0.0, size, 1.0)

    def jacobian(self, theta: Array) -> Array:
        """Return the derivatives of the whitened residuals by theta (m, p).

        Torque that is linear in its numbers by the regressor, all else by differences.
        """
        parameters = self.parameters
        # scaled torque of joints without effort is linear in nothing
        is_scaled = any(run.has_unpowered_joints for run in self._runs)
        recorded = {joint for run in self._runs for joint in run.recording.joints}
        linear, paths = ([], []) if is_scaled else parameters.linear(recorded)
        slopes = parameters.slopes(theta)
        found, here = np.empty((len(self.row_t), parameters.size)), self.whitened(theta)
        if linear:
            settings = parameters.settings(theta)
            robot = parameters.robot_at(settings)
            self._simulated.evaluations += 1
            by_numbers = np.concatenate(
                [run.torque_slopes(robot, paths, run.gains(settings)) for run in self._runs]
            )
            found[:, linear] = by_numbers @ slopes[np.ix_(linear, linear)]
            found[:, linear] /= self.deviation[self._channel][:, None]
        rest = sorted(set(range(parameters.size)) - set(linear))
        if self._is_followed:
            simulated = self._simulated
            slopes_of = simulated.slopes if self._is_exact else simulated.slopes_nearby
            found[:, rest] = self.whitening(slopes_of(theta, rest))
            return found
        of_robot = parameters.moves_robot
        own = [k for k in rest if parameters.runs[k]]
        if own:  # of one recording each: the others need not be worked out
            found[:, own] = self.whitening(self._simulated.slopes_by_run(theta, own))
            rest = [k for k in rest if not parameters.runs[k]]
        # what moves nothing first: it shares the motion that was just worked out
        for k in sorted(rest, key=lambda k: of_robot[k]):
            change = np.zeros(parameters.size)
            change[k] = STEP
            found[:, k] = (self.whitened(theta + change) - here) / STEP
        return found

    def _least_squares(
        self, theta: Array, rows: NDArray[np.bool_], tolerance: float, most: int = MOST_EVALUATIONS
    ) -> Array:
        count = int(rows.sum())

        prior = np.eye(len(theta)) / PRIOR

        def function(x: Array) -> Array:
            return np.concatenate([huber_residual(self.whitened(x)[rows]), x / PRIOR])

        def jacobian(x: Array) -> Array:
            weights = huber_slope(self.whitened(x)[rows])
            return np.concatenate([weights[:, None] * self.jacobian(x)[rows], prior])

        found = least_squares(
            function, theta, jacobian, method='trf', x_scale=1.0, xtol=1e-5, ftol=tolerance,
            gtol=1e-8 * count, max_nfev=most,
        )  # fmt: skip
        return np.asarray(found.x)

    def alone(self, theta: Array) -> Array:
        """Return about which share of each channel's residuals its run would leave by itself.

        To first order, with the prior: what one recording would have other numbers for.
        """
        residual, jacobian = self.whitened(theta), self.jacobian(theta)
        left = residual.copy()
        run_of = np.array([run for run, _, _ in self.labels])
        for run in dict.fromkeys(run_of):
            rows = (run_of == run)[self._channel]
            left[rows] += jacobian[rows] @ self._newton_step(theta, rows, centre=theta)
        every = np.ones(len(residual), dtype=bool)
        sides = [self._by_channel(each, every, held_rms) for each in (left, residual)]
        return np.asarray(np.minimum(sides[0] / np.maximum(sides[1], 1e-300), 1.0))

    def information(self, theta: Array) -> Information:
        """Information of the data alone about the reported numbers, in their sizes."""
        whitened = self.whitened(theta)
        residual, slope = huber_residual(whitened), huber_slope(whitened)
        jacobian = self.jacobian(theta) * slope[:, None]
        slopes, noise = self.parameters.slopes(theta), self._noise(theta)
        if still := [self.parameters.paths[k] for k in np.flatnonzero(~slopes.any(axis=1))]:
            raise IdentificationError(
                f'{", ".join(still)}: readings must vary by more than rounding, got none that do: '
                f'leave them out of --free'
            )
        by_numbers = np.linalg.inv(slopes) * self.parameters.scales(theta)
        jacobian = jacobian @ by_numbers
        info = information(
            jacobian,
            residual,
            self.blocks,
            self.whitening(self._by_joint_noise(theta)).T * slope,
            len(self.labels),
            None if noise is None else noise.by(by_numbers),
            left_beside_noise(self.parameters.is_sensor_offset),
        )
        # the estimate is beside the greatest likelihood by what prior and search's end leave
        return info.widened(residual @ jacobian)

    def _noise(self, theta: Array) -> JointNoise | None:
        """Effect of joint noise on the scores; None where no vibration is followed."""
        if not self._is_followed:
            return None
        return joint_noise(self.whitening, self._simulated, theta)

    def shaken(self, theta: Array, rows: NDArray[np.bool_]) -> Array:
        """Residual of each channel caused by joint noise over some rows, rms."""
        square = np.mean(self._by_joint_noise(theta) ** 2, axis=1)
        return self._by_channel(square, rows, lambda x: np.sqrt(np.mean(x)))

    def _by_joint_noise(self, theta: Array) -> Array:
        """Return changes of the residuals by noise of the joints, drawn anew (m, d)."""
        if self._drawn is None or self._drawn[0] != theta.tobytes():
            draws = [np.random.default_rng(k) for k in range(DRAWS)]
            # All at once would take the memory of as many motions.
            batches = [draws[k : k + TOGETHER] for k in range(0, DRAWS, TOGETHER)]
            found = [self._simulated.by_noise(theta, batch) for batch in batches]
            self._drawn = theta.tobytes(), np.hstack(found)
        return self._drawn[1]
