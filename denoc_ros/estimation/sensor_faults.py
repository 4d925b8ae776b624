"""Detection and isolation of faulty sensors by a bank of Kalman filters.

Each filter of the bank is one hypothesis: it uses all trusted sensors, or all but one. The state
of a filter is the deviation from the estimate of the joints alone, which no sensor can disturb.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from denoc_ros.estimation.amplitude_filter import MEMORY, AmplitudeFilter
from denoc_ros.kernels.jit.compiled import entry
from denoc_ros.kernels.runtime.fault_bank import advance_filters, compare_filters
from denoc_ros.types import Array, Flags

# What an estimate follows. The first is also the row of the filter that uses all trusted sensors.
ALL, JOINTS = 0, -1
# A sensor that fails again has to agree for longer, but at most so many times the first time.
LONGEST_TRIAL_FACTOR = 16.0


@dataclass(frozen=True)
class FaultTuning:
    """Thresholds of the fault detection; docs/trust.md has the measured sensitivity of each."""

    # s between two checks: the modes that carry most of the deflection are slower.
    check_interval: float = 0.02
    # s over which innovations count.
    window: float = 0.2
    # s over which the mean and the spread of values are taken.
    long_window: float = 1.0
    # Chi-squared by which the data must be better explained without a sensor than with it.
    evidence: float = 25.0
    # Largest chi-squared of a hypothesis that explains the data.
    explained: float = 20.0
    # Chi-squared by which a sensor must be a better explanation than any other sensor.
    clear: float = 8.0
    # Share of the model's error that is no steady share of the elastic forces.
    unsteady_error: float = 0.1
    # Weight of improbable loads: beams of other shapes than the model's have larger ones.
    load_weight: float = 0.4
    # Variances of an innovation that are still expected: stated noise is often too small.
    tolerance: float = 2.0
    # s by which stamps may be wrong: many sensors are dated by the arrival of their messages.
    timing_error: float = 0.01
    # Innovations larger than so many standard deviations count as this size.
    clip_sigmas: float = 3.0
    # Share of an expected value by which a beam's shapes may misrepresent it.
    shape_error: float = 0.02
    # s for which no hypothesis may explain the data before all sensors are tried again.
    decision_time: float = 0.3
    # A sensor agrees with the others while its mean squared innovation is below so many variances.
    agreement: float = 2.0
    # Chi-squared of the changes of the expected value while a sensor agreed: a gain that is wrong
    # by a tenth would have caused a hundredth of it.
    agreement_evidence: float = 4000.0
    # s for which sensors that all contradicted each other must agree before they are used again.
    # Each failure doubles it, up to `LONGEST_TRIAL_FACTOR` times.
    trial_time: float = 1.0
    # Times the initial error of the amplitudes, when the estimate of the sensors starts again.
    trial_doubt: float = 10.0


class SensorUnit(NamedTuple):
    """Values that fail together: one sensor."""

    name: str
    places: tuple[int, ...]  # of its values


class SensorFaults:
    """Finds sensors that contradict the joints and the other sensors.

    Parameters
    ----------
    units : sequence of SensorUnit
    model : AmplitudeFilter
        Transition and noise of the amplitudes; read only.
    step : float
        Time of one transition [s].
    model_error : float
        Standard deviation of the stiffness and load error, as a share of the elastic forces.
    biases : (b,) array
        Standard deviations of constant errors of values.
    patience : float
        Time for which an excluded sensor must agree until it is used again [s]; inf: never.

    Attributes
    ----------
    trusted : (units,) bool array
        Sensors that are not excluded.
    active : int
        What the estimate follows: `ALL` trusted sensors, or the `JOINTS` alone while sensors
        contradict each other and no single one of them explains it.
    causes : dict of str to str
        Why sensors are excluded, by their names.
    envelope : (m,) array or None
        Amplitudes of the present vibration; None before the second check.

    Notes
    -----
    A filter has the state x = [d; d'; f; b; e]: deviations of amplitudes and rates, forces that
    the model does not have, biases of values, and errors e of stiffness and load as steady shares
    of the elastic forces. A hypothesis has the score

        J = sum over the values, and over the window, of (nu^2 / s - c)
            + e^T P0^-1 e + f^T P_f^-1 f

    with nu the innovation of a value, s its variance after the values before it, and c
    `tolerance`; the sum of a value begins again where it is negative. It is the excess of
    chi-squared, and the improbability of the errors and forces that explain the data, whose
    covariances before any measurement are P0 and P_f. The difference of two
    scores is twice the logarithm of the likelihood ratio (A. S. Willsky, H. L. Jones, IEEE
    Transactions on Automatic Control 21, 1976).
    """

    def __init__(
        self,
        units: Sequence[SensorUnit],
        model: AmplitudeFilter,
        step: float,
        model_error: float,
        biases: Array,
        patience: float,
        tuning: FaultTuning | None = None,
    ) -> None:
        self.units, self._model, self._step = tuple(units), model, step
        self.tuning = FaultTuning() if tuning is None else tuning
        self._patience = patience
        self._m = m = len(model.stiffness)
        self._biases = biases
        self._shares = slice(3 * m + len(biases), 4 * m + len(biases))
        self._size = self._shares.stop
        self._model_error = model_error
        self._share_covariance = model.share_covariance(model_error, m)
        self._share_weights = np.linalg.inv(self._share_covariance)
        # Inertial sensors alone say too little of loads at rest to judge them.
        self._judges_loads = any(len(unit.places) == 1 for unit in units)
        self._load_deviation: Array = np.full(m, math.inf)
        self._unit_of = np.zeros(sum(len(unit.places) for unit in units), dtype=np.intp)
        for index, unit in enumerate(units):
            self._unit_of[list(unit.places)] = index
        self._columns = np.arange(len(self._unit_of))
        self._forward, self._compare = entry(advance_filters), entry(compare_filters)
        self._states: Array = np.zeros((0, self._size))
        self._covariances: Array = np.zeros((0, self._size, self._size))
        self._power: tuple[object, int, Array, Array] = (None, 0, np.eye(1), np.eye(1))
        self.reset()

    # ---- state

    def reset(self) -> None:
        """Trust all sensors; the next values start the filters."""
        self.trusted: Flags = np.ones(len(self.units), dtype=np.bool_)
        self.causes: dict[str, str] = {}
        self._moments = np.zeros((5, len(self._unit_of)))  # of expected and measured values
        self._patiences = np.full(len(self.units), 0.5 * self._patience)
        self._trial_time = 0.5 * self.tuning.trial_time
        self._load_error = self.tuning.unsteady_error * self._model_error
        weight = self.tuning.load_weight * self._judges_loads
        self._load_weights = weight * np.linalg.inv(self._model.independent_loads)
        self.active, self._is_trial = ALL, False
        self.restart()

    def restart(self) -> None:
        """Start the filters again at the next values; excluded sensors stay excluded.

        Sensors that contradicted each other have to agree before they are used again.
        """
        self._time, self._doubt = math.nan, 1.0
        if self.active == JOINTS:
            self._is_trial, self._doubt = True, self.tuning.trial_doubt
        # Without an envelope no load is improbable.
        self._load_deviation = np.full(self._m, math.inf)
        self.envelope: Array | None = None
        self._set_hypotheses(None)

    def adopt(self, other: SensorFaults) -> None:
        """Keep the exclusions of another detection of the same sensors, and their conditions."""
        self.trusted[:], self.causes = other.trusted, dict(other.causes)
        self.active, self._is_trial = other.active, other._is_trial
        self._patiences[:], self._trial_time = other._patiences, other._trial_time
        self.restart()

    @property
    def uses_all(self) -> bool:
        """Whether the estimate uses all sensors."""
        return self.active == ALL and self._excludes_none

    @property
    def uses_joints_only(self) -> bool:
        """Whether the estimate follows the joints alone."""
        return self.active == JOINTS or not self.trusted.any()

    @property
    def finding(self) -> str:
        """Which sensors are excluded, and why, in words of diagnostics; '' if all are used."""
        reasons = '; '.join(f'{name}: {cause}' for name, cause in self.causes.items())
        if self.uses_joints_only:
            joints = (
                'sensors contradict each other or the joints: the estimate uses the joints alone'
            )
            return f'{joints} ({reasons})' if reasons else joints
        return f'excluded: {reasons}' if reasons else ''

    def uses(self, place: int) -> bool:
        """Say whether the estimate may use a value."""
        return self.active == ALL and bool(self.trusted[self._unit_of[place]])

    def _set_hypotheses(self, source: int | None) -> None:
        """Make the hypotheses of the trusted sensors, each from the filter of one before."""
        trusted = np.flatnonzero(self.trusted)
        left_out = [None, *trusted.tolist()]  # by row, the index of the sensor that is left out
        self._left_out: list[int | None] = left_out
        count = len(left_out)
        # By sensor, the filter that leaves out this one only; that of all if it is excluded.
        self._row_without = np.zeros(len(self.units), dtype=np.intp)
        self._row_without[trusted] = np.arange(1, count)
        self._excludes_none = count > len(self.units)
        self._uses = np.tile(self.trusted, (count, 1))
        for row, index in enumerate(left_out[1:], 1):
            self._uses[row, index] = False
        state, covariance = np.zeros(self._size), np.zeros((self._size, self._size))
        if source is not None:
            state, covariance = self._states[source], self._covariances[source]
        self._states = np.tile(state, (count, 1))
        self._covariances = np.tile(covariance, (count, 1, 1))
        self._excess = np.zeros((count, len(self._unit_of)))
        self._open_since = math.nan  # since when no hypothesis is clearly the best
        # Since when excluded sensors agree, their mean square, and what has shown meanwhile.
        sensors = len(self.units)
        self._agreed_since = np.full(sensors, math.nan)
        self._squares, self._shown = (
            np.full(sensors, 2.0 * self.tuning.agreement),
            np.zeros(sensors),
        )
        self._shown_by_all = 0.0

    def _begin(self, time: float) -> None:
        """Start all filters at the estimate of the joints alone."""
        self._time = time
        first, m3 = np.zeros((self._size, self._size)), 3 * self._m
        first[:m3, :m3] = self._model.start_covariance(self._load_error, self._doubt)
        known = slice(m3, self._shares.start)
        first[known, known] = np.diag(self._biases**2)
        first[self._shares, self._shares] = self._share_covariance
        self._covariances[:] = first
        self._trial_from = time

    # ---- one check

    def is_due(self, stamp: float) -> bool:
        """Say whether values of a time [s] are to be checked."""
        passed = stamp - self._time
        return not passed < self.tuning.check_interval - 0.5 * self._step  # True for NaN

    def check(
        self, stamp: float, places: NDArray[np.intp], values: Array, rows: Array,
        squares: Array, base: Array,
    ) -> bool:  # fmt: skip
        """Compare values of one time with all hypotheses.

        Parameters
        ----------
        stamp : float
            Time of the values [s].
        places : (k,) int array
        values : (k,) array
            Measured values less their parts that do not depend on the state.
        rows : (k, s) array
            Their derivatives by the state [d; d'; f; b; e] of the robot.
        squares : (k,) array
            Variances of their errors.
        base : (2 m,) array
            Amplitudes and rates by the joints alone, at that time.

        Returns
        -------
        bool
            Whether the estimate has to go on from that of another hypothesis.
        """
        if math.isnan(self._time):
            self._begin(stamp)
        else:
            self._advance(stamp, base)
        expected = rows[:, : 2 * self._m] @ base
        misshapen = self.tuning.shape_error * expected
        unit = self._unit_of[places]
        used = np.ascontiguousarray(self._uses[:, unit])
        count = len(self._states)
        innovations, variances, chi = np.empty((3, count, len(places)))
        clip = self.tuning.clip_sigmas**2
        self._compare(
            self._states, self._covariances, rows, values - expected,
            squares + misshapen * misshapen, used, clip, innovations, variances, chi,
        )  # fmt: skip
        excess = self._excess[:, places] + chi - self.tuning.tolerance
        self._excess[:, places] = np.maximum(excess, 0.0)
        first = innovations[ALL]
        said = values - first
        self._note_agreement(unit, said - self._moments[0, places], first, variances[ALL])
        self._note_moments(places, unit, values, innovations)
        return self._decide(stamp)

    def _advance(self, stamp: float, base: Array) -> None:
        """Bring all filters to a time [s]."""
        m, model, tuning = self._m, self._model, self.tuning
        steps = max(0, math.floor((stamp - self._time) / self._step + 0.5))
        elapsed = steps * self._step
        self._time += elapsed
        alone, pushed = self._transition(steps)
        amplitudes = base[:m] + self._states[:, :m]
        rates = base[m:] + self._states[:, m : 2 * m]
        # The least of the filters without a sensor: a faulty sensor makes large amplitudes, and
        # with them the model's error would seem large enough to explain its values.
        envelopes = model.envelope(amplitudes, rates)
        self.envelope = envelopes[ALL]
        least = envelopes[1:].min(axis=0) if len(envelopes) > 1 else self.envelope
        deviation = model.load_deviation(least, self._load_error)
        # Where no load is expected, as without gauges at rest, none is judged.
        self._load_deviation = np.where(deviation > 0.0, deviation, math.inf)
        self._forward(
            self._states, self._covariances, alone, pushed, model.stiffness, base[:m],
            model.load_noise(deviation, steps),
            (2.0 * elapsed / MEMORY) * self._share_covariance,
        )  # fmt: skip
        # Of sensors that are slower than the checks, as many values count.
        self._excess *= 1.0 - min(elapsed, tuning.check_interval) / tuning.window

    def _transition(self, steps: int) -> tuple[Array, Array]:
        """Return the transition (3 m, 3 m) of some steps, and that of steady forces (3 m, m)."""
        of_one = self._model.linear_steps
        if self._power[0] is not of_one or self._power[1] != steps:
            one, push = of_one
            size, count = push.shape
            steady = np.eye(size + count)  # of the forces
            steady[:size, :size], steady[:size, size:] = one, push
            power = np.linalg.matrix_power(steady, steps)
            self._power = of_one, steps, power[:size, :size].copy(), power[:size, size:].copy()
        return self._power[2], self._power[3]

    @property
    def scores(self) -> Array:
        """How badly each hypothesis explains the data, as chi-squared (hypotheses,)."""
        shares = self._states[:, self._shares]
        loads = self._states[:, 2 * self._m : 3 * self._m] / self._load_deviation
        improbable = (shares @ self._share_weights) * shares + (loads @ self._load_weights) * loads
        return np.asarray(self._excess.sum(axis=1) + improbable.sum(axis=1))

    # ---- decisions

    def _decide(self, now: float) -> bool:
        """Say whether the estimate has to follow another filter from now [s] on."""
        if self._readmit(now):
            return True
        tuning, scores = self.tuning, self.scores.tolist()
        # Once sensors contradict each other, they agree only well below the threshold.
        least = tuning.evidence if self.active == ALL else 0.5 * tuning.evidence
        singles = sorted(range(1, len(scores)), key=scores.__getitem__)
        if not singles or (scores[ALL] - scores[singles[0]] < least and scores[ALL] < 2.0 * least):
            self._open_since = math.nan
            return self._use_all(now, scores)
        if math.isnan(self._open_since):
            self._open_since = now
        best = singles[0]
        explains = scores[best] < tuning.explained
        if (
            explains
            and scores[ALL] - scores[best] >= tuning.evidence
            and (len(singles) == 1 or scores[singles[1]] - scores[best] > tuning.clear)
        ):
            return self._exclude(best, now)
        if not explains and now - self._open_since >= tuning.decision_time:
            return self._give_up(now)
        was_active, self.active = self.active, JOINTS
        return was_active != JOINTS

    def _use_all(self, now: float, scores: list[float]) -> bool:
        """Follow all trusted sensors; after a contradiction of all once they have agreed."""
        tuning = self.tuning
        if self.active == ALL or (
            self._is_trial
            and (
                now - self._trial_from < self._trial_time
                or self._shown_by_all < tuning.agreement_evidence
                or scores[ALL] > tuning.explained
            )
        ):
            return False
        self.active, self._is_trial = ALL, False
        known = {
            unit.name for unit, good in zip(self.units, self.trusted, strict=True) if not good
        }
        self.causes = {name: cause for name, cause in self.causes.items() if name in known}
        return True

    def _exclude(self, row: int, now: float) -> bool:
        """Exclude the sensor that a hypothesis leaves out."""
        index = self._left_out[row]
        assert index is not None
        self.trusted[index] = False
        # A sensor that fails again has to agree for longer.
        most = LONGEST_TRIAL_FACTOR * self._patience
        self._patiences[index] = min(2.0 * self._patiences[index], most)
        self.causes[self.units[index].name] = self._describe(index)
        # One sensor may be wrong, or less than half of many.
        if int(np.count_nonzero(~self.trusted)) > max(1, (len(self.units) - 1) // 2):
            return self._give_up(now)
        self._set_hypotheses(row)
        if self._is_trial:
            self._trial_from = now
        else:
            self.active = ALL
        return True

    def _give_up(self, now: float) -> bool:
        """Use the joints alone; try all sensors again from the estimate of the joints."""
        was_active, self.active, self._is_trial = self.active, JOINTS, True
        self.trusted[:] = True
        self._doubt = self.tuning.trial_doubt
        most = LONGEST_TRIAL_FACTOR * self.tuning.trial_time
        self._trial_time = min(2.0 * self._trial_time, most)
        self._set_hypotheses(None)
        self._begin(now)
        return was_active != JOINTS

    def _note_agreement(
        self, unit: NDArray[np.intp], changes: Array, innovations: Array, variances: Array
    ) -> None:
        """Compare values (k,) of excluded sensors with those expected by the trusted ones.

        Only changes of the expected values count: a constant value agrees with a sensor that is
        stuck or late.
        """
        tuning = self.tuning
        shown = changes**2 / variances
        self._shown_by_all += float(shown.sum())
        if self._excludes_none:
            return
        share = tuning.check_interval / tuning.long_window
        squares = innovations**2 / variances
        for index in np.unique(unit[~self.trusted[unit]]).tolist():
            own = unit == index
            worst = min(float(squares[own].max()), tuning.clip_sigmas**2)
            self._squares[index] += share * (worst - self._squares[index])
            self._shown[index] += float(shown[own].max())
            if self._squares[index] > tuning.agreement:
                self._agreed_since[index], self._shown[index] = math.nan, 0.0
            elif math.isnan(self._agreed_since[index]):
                self._agreed_since[index] = self._time

    def _readmit(self, now: float) -> bool:
        """Trust excluded sensors again that have agreed for long and clearly enough."""
        if self._excludes_none:
            return False
        good = (
            ~self.trusted
            & (now - self._agreed_since >= self._patiences)
            & (self._shown >= self.tuning.agreement_evidence)
        )
        for index in np.flatnonzero(good).tolist():
            self.trusted[index] = True
            self.causes.pop(self.units[index].name, None)
        if good.any():
            self._set_hypotheses(ALL)
        return bool(good.any())

    # ---- the kind of a fault

    def _note_moments(
        self, places: NDArray[np.intp], unit: NDArray[np.intp], values: Array, innovations: Array
    ) -> None:
        """Collect mean values and products of expected and measured values, for a description."""
        share = self.tuning.check_interval / self.tuning.long_window
        said = values - innovations[self._row_without[unit], self._columns[: len(places)]]
        samples = np.array((said, values, said * said, said * values, values * values))
        moments = self._moments[:, places]
        self._moments[:, places] = moments + share * (samples - moments)

    def _describe(self, index: int) -> str:
        """Describe how a sensor differs from the expectation of the others."""
        worst = ''
        for place in self.units[index].places:
            said, value, said2, product, value2 = self._moments[:, place]
            varies, measured = said2 - said * said, value2 - value * value
            if measured <= 1e-4 * varies:
                return 'its value does not change'
            correlated = (product - said * value) ** 2 > 0.8 * varies * measured
            if correlated and varies > 0.0:
                worst = (
                    f'it reads {(product - said * value) / varies:.2g} times the expected value'
                )
        return worst or 'it contradicts the joints and the other sensors'

    # ---- result

    def estimate(self, time: float, base: Array) -> tuple[Array, Array]:
        """Return the state x = [d; d'; f; b; e] and covariance that the estimate goes on from.

        Parameters
        ----------
        time : float
            [s], of `base`.
        base : (2 m,) array
            Amplitudes and rates by the joints alone, then.
        """
        m = self._m
        state = np.zeros(self._size)
        if not self.uses_joints_only:
            steps = max(0, math.floor((time - self._time) / self._step + 0.5))
            alone, pushed = self._transition(steps)
            state[:] = self._states[ALL]
            forces = self._model.stiffness * (base[:m] + state[:m]) * state[self._shares]
            state[: 3 * m] = alone @ state[: 3 * m] + pushed @ forces
        state[: 2 * m] += base
        return state, self._covariances[ALL]
