"""Fusion of strain gauges, load cells and deflection sensors with the model's amplitudes."""

from __future__ import annotations

import bisect
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.elastic.state_history import StateHistory
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.structure import composed_sensors, sensor_rows
from denoc_ros.errors import StateError
from denoc_ros.estimation.amplitude_filter import LARGEST, AmplitudeFilter, MeasurementModel
from denoc_ros.estimation.sensor_faults import SensorFaults, SensorUnit
from denoc_ros.model.sensors import inertial_values
from denoc_ros.model.tree import Sensor
from denoc_ros.settings import documented, require_declared, setting
from denoc_ros.types import Array

Value = tuple[float, int, float]  # stamp, place, value

WAITING = 1024  # values at most that wait for the joints' motion up to their stamps
BASE_HISTORY = 1024  # states by the joints alone that are kept for values that come late
INERTIAL_SHARE = 0.1  # of the error at the start that inertial sensors alone are to find
OUTLIERS_LAST = 0.1  # s of outliers of a trusted sensor after which the state counts as wrong
CREEP = 0.1  # of a step, by which a sensor may come later with each value
MOST_STEPS = 250  # a covariance older than this is started anew


@documented
@dataclass(frozen=True)
class FusionSettings:
    """How sensors are fused.

    Raises
    ------
    StateError
        If a value is out of range.
    """

    model_error: float = setting(
        0.2,
        "assumed error of the model's forces, as a share of the elastic forces",
        positive=True,
    )
    # a tenth of it where there are inertial sensors alone, which do not show it
    initial_deflection: float = setting(
        0.01,
        "assumed error of a tip's deflection at the start, as a share of the beam's length",
        positive=True,
    )
    gate: float = setting(
        5.0,
        'distance from the prediction, in standard deviations, beyond which a value is an outlier',
        positive=True,
    )
    patience: float = setting(
        0.2,
        'time for which an excluded sensor must agree with the others until it is used again; '
        'inf: never',
        's',
        positive=True,
    )
    # it makes a value that changes quickly count less
    timing_error: float = setting(
        0.001,
        "standard deviation of the error of the sensors' stamps; 0: stamps are exact",
        's',
        0.0,
    )

    def __post_init__(self) -> None:
        require_declared(self, 'fusion')


class StrainFusion:
    """Corrects amplitudes and rates by sensors' values as they come, at any rate, in any order.

    A value is compared with the amplitudes at its own stamp; the correction there is carried on
    to the newest state. One from before the last one taken in corrects the covariance of then.

    Parameters
    ----------
    robot : Robot
        The model; worked on as a copy.
    step : float
        Step of the covariance [s].
    max_age : float
        Values older than this against the joints' motion [s] are refused.
    free : int array, optional
        Coordinates whose motion is not given to the model; default the amplitudes.
    accelerations, uncertainty : callables, optional
        What inertial sensors need, as of :class:`InertialRows`, and gauges where the beam's own
        inertia bends it. Without it, and on robots with loops, gauges read the beams' shapes.

    Attributes
    ----------
    names : tuple of str
        Of the sensors on beams, then of each value of the inertial ones (`imu/gyro_x`).
    inertial : InertialRows
    biases : (values,) array
        Estimated constant errors of the inertial sensors' values.
    loads : (m,) array
        Generalized forces on the amplitudes that the model leaves out.
    shares : (m + loads,) array
        Shares of the elastic forces, and of those that the loads at the ends take, that the model
        leaves out beside them; empty without inertial sensors.
    counts : list of Counter
        Per value of the robot's sensors: accepted, and refused by cause.
    heard, used : (sensors,) arrays
        Stamps of the newest values, and of the newest accepted ones [s], NaN where none came.
    faults : SensorFaults
        Which sensors are excluded, and why.

    Raises
    ------
    StateError
        The robot has no sensor, or one has no noise.
    """

    def __init__(
        self,
        robot: Robot,
        step: float,
        settings: FusionSettings,
        max_age: float,
        free: NDArray[np.int64] | None = None,
        accelerations: Accelerations | None = None,
        uncertainty: Callable[[], Array] | None = None,
    ) -> None:
        sensors = robot.tree.sensors
        _require_noise(robot, sensors)
        self.inertial = InertialRows(robot)
        self._accelerations, self._uncertainty = accelerations, uncertainty
        self.names = (*(sensor.name for sensor in sensors), *self.inertial.names)
        self._beams = len(sensors)
        self._settings, self._step = settings, step
        self._flexible = robot.flexible_indices
        self._m = m = len(self._flexible)
        self._shift = np.zeros(len(sensors))  # of the values against shapes . amplitudes
        self._reading = MeasurementModel(
            np.ascontiguousarray(sensor_rows(robot)[:, self._flexible]),
            np.zeros((len(sensors), 3 * m)),
            np.zeros(len(sensors)),
            np.zeros(len(sensors)),
            np.array([sensor.noise for sensor in sensors]),
            settings.timing_error,
            settings.model_error,
        )
        self._mobility: Array | None = None  # for which the line is
        self._moments = bool(sensors) and accelerations is not None and not robot.tree.loops
        self._bent = robot if composed_sensors(robot) else None
        self.filter = AmplitudeFilter(
            robot.copy(),
            step,
            settings.model_error,
            settings.initial_deflection * (1.0 if sensors else INERTIAL_SHARE),
            free,
            self.inertial.bias,
            steady=self.inertial.loads if self.inertial.names else None,
        )
        self.filter.set_floor(self._reading.shapes, self._reading.noise)
        self._trail = StateHistory(math.ceil(max_age / step) + 2, 2 * m)
        self._base = StateHistory(BASE_HISTORY, 2 * robot.n)  # by the joints alone
        self._both = np.concatenate((self._flexible, robot.n + self._flexible))
        self.faults = SensorFaults(
            _sensor_units(robot, self.inertial.names),
            self.filter,
            step,
            settings.model_error,
            self.inertial.bias,
            settings.patience,
        )
        self._has_to_follow = False  # another hypothesis of `faults`
        self._max_age = max_age
        self._waiting: list[Value] = []
        self.loads, self.biases = np.zeros(m), np.zeros(len(self.inertial.names))
        self.shares = np.zeros(m + self.inertial.loads if self.inertial.names else 0)
        self.counts: list[Counter[str]] = [Counter() for _ in self.names]
        self.heard, self.used = np.full((2, len(self.names)), np.nan)
        self._refused_since = np.full(len(self.names), np.nan)
        self._behind = [math.nan] * len(self.names)  # the joints, at least [s]
        self._creep = CREEP * step
        self._time = math.nan  # of the covariance

    def reset(self, time: float, q: Array, qd: Array) -> None:
        """Start at a time [s] from coordinates and rates (n,)."""
        self.loads[:] = self.biases[:] = self.shares[:] = 0.0
        self.faults.reset()
        self._base.clear()
        self.restart(time, q, qd)

    def restart(self, time: float, q: Array, qd: Array) -> None:
        """Go on after a gap: the loads stay."""
        self._waiting.clear()
        self._trail.clear()
        self.faults.restart()
        self._has_to_follow = False
        self.inertial.forget()
        self._refused_since[:] = np.nan
        self.filter.reset(q)
        self._time = time
        self._note(time, q, qd)

    def _note(self, time: float, q: Array, qd: Array) -> None:
        state = self._trail.push(time)
        state[: self._m] = q[self._flexible]
        state[self._m :] = qd[self._flexible]

    def follow_joints(self, time: float, q: Array, qd: Array) -> None:
        """Take the state (n,) by the joints alone at a time [s]."""
        state, n = self._base.push(time), len(q)
        state[:n], state[n:] = q, qd

    def _by_joints(self, time: float) -> Array:
        """Return amplitudes and rates (2 m,) by the joints alone at a time [s]."""
        return np.asarray(self._base.at(time)[self._both])

    def follow(self, time: float, q: Array, qd: Array) -> None:
        """Take the next state (n,) of the model at a time [s], one step or so later."""
        self._note(time, q, qd)
        self.loads *= self.filter.decay

    def sense(self, place: int, stamp: float, value: float) -> bool:
        """Take a value in, to be used when the joints' motion has come to its stamp.

        Parameters
        ----------
        place : int
            Of the value among `names`.
        stamp : float
            When it was measured [s].
        value : float
            In the unit of the sensor's value.

        Returns
        -------
        bool
            False if it was refused; `counts` say why.
        """
        counts = self.counts[place]
        if not (math.isfinite(value) and math.isfinite(stamp)):
            counts['not_finite'] += 1
            return False
        behind = self._trail.last - stamp
        if not behind > 0.0:  # NaN without a state
            behind = 0.0
        crept, heard = self._behind[place] + self._creep, self.heard.item(place)
        self._behind[place] = crept if crept < behind else behind  # at first it is NaN
        if stamp == heard:
            counts['repeated'] += 1
            return False
        if len(self._waiting) == WAITING:
            oldest = self._waiting.pop(0)
            self.counts[oldest[1]]['overflow'] += 1
        bisect.insort(self._waiting, (stamp, place, value))
        if not stamp < heard:
            self.heard[place] = stamp
        return True

    def correct(self, q: Array, qd: Array) -> None:
        """Correct the newest state (n,) in place by the values that it has come up to."""
        waiting, trail, near = self._waiting, self._trail, 0.5 * self._step
        if not waiting or waiting[0][0] > trail.last + near:
            return
        until = trail.last + near - self._hold()
        if waiting[0][0] > until:
            return
        self.filter.linearize(q)
        if self._bent is not None:
            # deflections of segments are not linear
            rows = self._bent.beam_sensor_rows(q)
            self._reading.shapes[:] = rows[:, self._flexible]
            self._shift = self._bent.beam_sensor_values(q) - rows @ q
            self._reading.constant[:] = self._shift
        if self._moments:
            self._find_moments(q, qd)
        while waiting and waiting[0][0] <= until:
            # those of one instant together: their clocks need not agree to the last digit
            first = waiting[0][0]
            count = bisect.bisect_right(waiting, (first + near, len(self.names), 0.0))
            group, waiting[:count] = waiting[:count], []
            on_beams, inertial = group, []
            if self.inertial.names:
                on_beams = [value for value in group if value[1] < self._beams]
                inertial = [value for value in group if value[1] >= self._beams]
            if trail.last - first > self._max_age or first < trail.first - near:
                self._late(on_beams)
            elif on_beams:
                self._take(on_beams, q)
            if inertial and trail.last - first > OLDEST:
                self._late(inertial)
            elif inertial:
                self._take_inertial(inertial, q, qd)
        if self._has_to_follow:
            self._follow_hypothesis(q)
        newest = trail.at(trail.last)
        q[self._flexible] = newest[: self._m]
        qd[self._flexible] = newest[self._m :]

    def _follow_hypothesis(self, q: Array) -> None:
        """Go on from the estimate of the hypothesis that `faults` found, at coordinates q (n,)."""
        self._has_to_follow = False
        m, model, now = self._m, self.filter, self._trail.last
        base = self._by_joints(now)
        state, covariance = self.faults.estimate(now, base)
        forces = np.diag(model.stiffness * state[:m])
        known, size = 3 * m + len(self.biases), len(state)
        model.reset(q)
        if len(self.shares):
            model.covariance[:size, :size] = covariance
            self.shares[:m], self.shares[m:] = state[known:], 0.0
        else:  # the loads take the part of the shares
            onto = np.eye(known, size)
            onto[2 * m : 3 * m, known:] = forces
            model.covariance[:] = onto @ covariance @ onto.T
            state = onto @ state
        self.loads[:] = state[2 * m : 3 * m]
        self.biases[:] = state[3 * m : known]
        self._time = now
        self._trail.clear()
        self._trail.push(now)[:] = state[: 2 * m]
        self._refused_since[:] = np.nan

    def _check(
        self, stamp: float, places: NDArray[np.intp], values: Array, rows: Array, squares: Array,
        base: Array,
    ) -> None:  # fmt: skip
        """Look for faults in values of a time [s], less their parts that depend on no state."""
        if self.faults.check(stamp, places, values, rows, squares, base):
            self._has_to_follow = True

    def _trusted(self, group: list[Value]) -> list[Value]:
        """Return the values of a group that the estimate may use; count the others."""
        if self.faults.uses_all:
            return group
        used = [value for value in group if self.faults.uses(value[1])]
        for value in group:
            if value not in used:
                self.counts[value[1]]['excluded'] += 1
        return used

    def _hold(self) -> float:
        """Return how long values wait for those of sensors that come later [s].

        A value from before the last one taken in would count by a line through the amplitudes,
        which fast modes leave within milliseconds. Inertial sensors' values cannot wait.
        """
        if self.inertial.names:
            return 0.0
        oldest, most = self._trail.last - self._max_age, 0.0
        for lag, at in zip(self._behind, self.heard.tolist(), strict=True):
            if lag > most and at >= oldest:
                most = lag
        return most

    def _find_moments(self, q: Array, qd: Array) -> None:
        """Find the gauges' part beyond the shapes at the newest state (n,), and its rate.

        With d'' = M^-1 (f - K d - C d' + ...) its derivatives by [d; d'; f] are
        R M^-1 [-K, -C, 1], R those by d''.
        """
        assert self._accelerations is not None
        robot, qdd = self._accelerations(self._trail.last, q, qd)
        model, m, reading = self.filter, self._m, self._reading
        reading.beyond[:] = robot.beyond_shapes(q, qd, qdd)
        if self._mobility is not model.held_mobility:
            self._mobility = model.held_mobility
            by_force = robot.beyond_shapes_by_accelerations(q)[:, self._flexible] @ self._mobility
            reading.moved[:, :m] = -by_force * model.stiffness
            reading.moved[:, m : 2 * m] = -by_force * model.damping
            reading.moved[:, 2 * m :] = by_force
        now = np.concatenate((self._trail.at(self._trail.last), self.loads))
        reading.constant[:] = self._shift + reading.beyond - reading.moved @ now

    def _late(self, group: list[Value]) -> None:
        for _, place, _ in group:
            self.counts[place]['late'] += 1

    def _take_inertial(self, group: list[Value], q: Array, qd: Array) -> None:
        """Correct the newest state, the loads and biases by values of about its time."""
        assert self._accelerations is not None
        assert self._uncertainty is not None
        now, inertial, m = self._trail.last, self.inertial, self._m
        newest = self._trail.since(now)[1][0]
        expected = np.concatenate((newest, self.loads, self.biases, self.shares))
        self._go_on(now, expected, q)
        q[self._flexible], qd[self._flexible] = expected[:m], expected[m : 2 * m]
        inertial.move(now, q, qd, self._accelerations, self._uncertainty, self.filter)
        which = [place - self._beams for _, place, _ in group]
        ages = np.array([now - stamp for stamp, _, _ in group])
        change = inertial.change[which]
        seen = inertial.expected[which] - ages * change
        rows = inertial.rows[which]
        values = np.array([value for _, _, value in group]) - seen
        known = slice(3 * m, 3 * m + len(self.biases))
        values += rows @ expected - rows[:, known] @ self.biases
        moved = (self._settings.timing_error + np.abs(ages)) * change
        noise = np.sqrt(inertial.noise[which] ** 2 + moved**2 + inertial.uncertain[which] ** 2)
        if self.faults.is_due(now) and len(self._base):
            # A sensor may have sent several.
            at = list({place: k for k, (_, place, _) in enumerate(group)}.values())
            of_model = np.ascontiguousarray(rows[at, : 4 * m + len(self.biases)])
            # Its noise is far below the model's error of a specific force: an error as large as a
            # bias is no fault.
            squares = noise[at] ** 2 + inertial.bias[which][at] ** 2
            places = np.array([group[k][1] for k in at])
            self._check(now, places, values[at], of_model, squares, self._by_joints(now))
        kept = [k for k, value in enumerate(group) if self.faults.uses(value[1])]
        if len(kept) < len(group):
            group = self._trusted(group)
            rows, noise, values = rows[kept], noise[kept], values[kept]
        state = expected.copy()
        taken = self.filter.correct_rows(rows, noise, values, self._settings.gate, state)
        for (stamp, place, _), good in zip(group, taken.tolist(), strict=True):
            self._judge(place, stamp, good)
        self._spread(state - expected, now)

    @property
    def is_steady(self) -> bool:
        """Whether the forces outside the model do not depend on its state."""
        return not len(self.shares)

    def forces(self, q: Array, qd: Array, ahead: float = 0.0) -> Array:
        """Forces outside the model (m,) at a state (n,), a time after it [s]."""
        if self.is_steady:
            return self.loads
        bent = q[self._flexible] + ahead * qd[self._flexible]
        forces: Array = self.loads + self.filter.shared(bent) @ self.shares
        return forces

    def unexplained(self) -> Array:
        """Return the part of the sensors' values due to the loads, taken as slow (sensors,).

        The rest is what the model alone explains.
        """
        values: Array = self._reading.shapes @ (self.loads / self.filter.stiffness)
        return values

    def _take(self, group: list[Value], q: Array) -> None:
        """Correct the trail from the values' stamp on, and the loads."""
        stamp = group[0][0]
        if self.faults.is_due(stamp) and len(self._base):
            self._check_beams(stamp, group)
        group = self._trusted(group)
        if not group:
            return
        places = [place for _, place, _ in group]
        state = np.concatenate((self._trail.at(stamp), self.loads, self.biases, self.shares))
        self._go_on(stamp, state, q)
        lag = self._time - stamp
        # where the covariance is of later, rates lead the amplitudes of then there
        lag = lag if lag > 0.5 * self._step else 0.0
        values = np.array([value for _, _, value in group])
        change, taken = self.filter.correct_readings(
            np.array(places), values, self._reading, lag, self._settings.gate, state
        )
        for place, good in zip(places, taken.tolist(), strict=True):
            self._judge(place, stamp, good > 0.0)
        self._spread(change, max(stamp, self._time))

    def _check_beams(self, stamp: float, group: list[Value]) -> None:
        """Look for faults in values of sensors on beams of a time [s]."""
        reading, m, base = self._reading, self._m, self._by_joints(stamp)
        newest = {place: value for _, place, value in group}  # a sensor may have sent several
        places = np.array(list(newest))
        shapes = reading.shapes[places]
        rows = np.zeros((len(places), 4 * m + len(self.biases)))
        rows[:, : 3 * m] = reading.moved[places]
        rows[:, :m] += shapes
        values = np.array(list(newest.values())) - reading.constant[places]
        timing_error = max(reading.timing_error, self.faults.tuning.timing_error)
        moved = timing_error * (shapes @ base[m:])
        unsure = reading.model_error * reading.beyond[places]
        squares = reading.noise[places] ** 2 + moved * moved + unsure * unsure
        self._check(stamp, places, values, rows, squares, base)

    def _go_on(self, stamp: float, state: Array, q: Array) -> None:
        """Bring the covariance to a stamp, unless it is there."""
        steps = math.floor((stamp - self._time) / self._step + 0.5)
        if steps > MOST_STEPS:
            self.filter.reset(q)
            self._time = stamp
        elif steps > 0:
            # The estimate's own amplitudes would let a faulty sensor raise the model's error, and
            # with it its own weight.
            envelope = self.faults.envelope
            self.filter.predict(state[: self._m], state[self._m : 2 * self._m], steps, envelope)
            self._time += steps * self._step

    def _judge(self, place: int, stamp: float, good: bool) -> None:
        """Count a value; start again from `faults` where a trusted sensor gives only outliers."""
        self.counts[place]['accepted' if good else 'outlier'] += 1
        if good:
            self.used[place] = stamp
            self._refused_since[place] = math.nan
        elif math.isnan(self._refused_since[place]):
            self._refused_since[place] = stamp
        elif stamp - self._refused_since[place] >= OUTLIERS_LAST:
            # Sensors agree with each other, since none of them is excluded: the state is wrong.
            self._has_to_follow = True

    def _spread(self, change: Array, time: float) -> None:
        """Add a correction of x at a time [s] to the trail from there on, loads and biases."""
        m, near = self._m, 0.5 * self._step
        times, states = self._trail.since(time - near)
        for at, state in zip(times.tolist(), states, strict=True):
            while at - time > near:
                change = self.filter.carry(change)
                time += self._step
            state += change[: 2 * m]
        self.loads += change[2 * m : 3 * m]
        known = 3 * m + len(self.biases)
        if known == len(change):  # no inertial sensors
            return
        self.biases += change[3 * m : known]
        self.shares += change[known:]
        np.clip(self.shares, -LARGEST, LARGEST, out=self.shares)

    def adopt(self, other: StrainFusion | None) -> bool:
        """Go on from another's state; not if that has other sensors, or is None: then False."""
        if other is None or other.names != self.names:
            return False
        self.filter.adopt(other.filter)
        self._trail.adopt(other._trail)
        self._waiting = other._waiting
        self.loads[:], self._refused_since[:] = other.loads, other._refused_since
        self.biases[:], self.shares[:] = other.biases, other.shares
        self.inertial.forget()
        self.heard, self.used, self.counts = other.heard, other.used, other.counts
        self._behind, self._time = other._behind, other._time
        self.faults.adopt(other.faults)
        self._base.adopt(other._base)
        return True


def _sensor_units(robot: Robot, inertial: tuple[str, ...]) -> list[SensorUnit]:
    """Return the sensors with the places of their values: on beams, then inertial ones."""
    units = [SensorUnit(sensor.name, (place,)) for place, sensor in enumerate(robot.tree.sensors)]
    first = len(units)
    for sensor in robot.tree.inertial_sensors:
        places = tuple(
            first + k for k, name in enumerate(inertial) if name.rpartition('/')[0] == sensor.name
        )
        units.append(SensorUnit(sensor.name, places))
    return units


def _require_noise(robot: Robot, sensors: tuple[Sensor, ...]) -> None:
    name = robot.tree.name
    if not sensors and not robot.tree.inertial_sensors:
        raise StateError(f'{name}: fused sensors must be at least one, got none')
    silent = [sensor.name for sensor in sensors if not sensor.noise > 0.0]
    if silent:
        raise StateError(
            f'{name}: sensors that are fused must have noise > 0 (their standard deviation, in '
            f'the unit of the value), got 0 for {", ".join(silent)}'
        )


# rows of inertial sensors -----------------------------------------------------------------------

# time, coordinates and rates (n,) to the robot on its base of then and the accelerations (n,)
Accelerations = Callable[[float, Array, Array], 'tuple[Robot, Array]']

OLDEST = 0.005  # s behind the joints: what a line through the newest values still serves
REFRESH = 0.01  # s after which the rows are worked out anew
CHANGE = 0.01  # of a load, in the difference that is its derivative


class InertialRows:
    """Values of inertial sensors about a state x = [d; d'; f; b; e], b their biases.

    Forces on the amplitudes that the model leaves out are f + P e, e shares of the elastic forces
    and of what the loads at the ends of the robot take.

    Attributes
    ----------
    names : tuple of str
        Of the values, such as `imu/gyro_x`.
    noise, bias : (k,) arrays
        Standard deviations: of the values, and of their constant errors at the start.
    expected, change : (k,) arrays
        The values without biases at the last state, and by how much they change per second.
    loads : int
        Bodies on which no other stands: each may be heavier or lighter than the model says.
    rows : (k, 4 m + k + loads) array
        Their derivatives by x.
    uncertain : (k,) array
        Deviation of the values by the joints' accelerations.

    Raises
    ------
    StateError
        A sensor has no noise, or the robot has loops.

    Notes
    -----
    With the joints' accelerations measured, whatever drives the model,
    d'' = M^-1 (f - K d - C d' + ...) makes a specific force a function of the state: with H the
    derivatives by d, d' and d'', the rows are
    [H_d - H_a M^-1 K, H_v - H_a M^-1 C, H_a M^-1, 1, H_a M^-1 P].
    """

    def __init__(self, robot: Robot) -> None:
        sensors = inertial_values(robot.tree)
        self.names = tuple(value.name for value in sensors)
        self.noise = np.array([value.noise for value in sensors])
        self.bias = np.array([value.bias for value in sensors])
        self._places = [value.place for value in sensors]
        _require(robot, self.names, self.noise)
        count, m = len(self.names), len(robot.flexible_indices)
        self._plain = robot.copy()
        self._heavier = [
            robot.with_scaled_load(frame, 1.0 + CHANGE) for frame in _ends(robot) if sensors
        ]
        self.loads = len(self._heavier)
        self.rows = np.zeros((count, 4 * m + count + self.loads))
        self.rows[:, 3 * m : 3 * m + count] = np.eye(count)
        self.expected, self.change, self.uncertain = np.zeros((3, count))
        self._by_acceleration = np.zeros((count, robot.n))
        if sensors:  # nothing compiles in the loop
            zero = np.zeros(robot.n)
            robot.sensor_values(zero)
            robot.sensor_derivatives(zero)
        self.forget()

    def forget(self) -> None:
        """Forget the last state: the next one is elsewhere."""
        self._time = self._refreshed = -math.inf

    def move(
        self, time: float, q: Array, qd: Array, motion: Accelerations,
        uncertainty: Callable[[], Array], model: AmplitudeFilter,
    ) -> None:  # fmt: skip
        """Work out values and rows at a time [s] and its state (n,).

        `uncertainty` gives the deviations (n,) of the accelerations that are measured.
        """
        robot, qdd = motion(time, q, qd)
        values = robot.sensor_values(q, qd, qdd)[self._places]
        passed = time - self._time
        if 0.0 < passed <= OLDEST:
            self.change = (values - self.expected) / passed
        elif passed:
            self.change = np.zeros(len(values))
        if time - self._refreshed >= REFRESH:
            self._refresh(robot, q, qd, qdd, model)
            self._refreshed = time
        self.expected, self._time = values, time
        self.uncertain = np.abs(self._by_acceleration) @ uncertainty()

    def _refresh(
        self, robot: Robot, q: Array, qd: Array, qdd: Array, model: AmplitudeFilter
    ) -> None:
        flexible, m = robot.flexible_indices, len(robot.flexible_indices)
        derivatives = robot.sensor_derivatives(q, qd, qdd, by_shapes=True)
        self._by_acceleration = derivatives[2][self._places]
        by_q, by_qd, by_qdd = (each[self._places][:, flexible] for each in derivatives)
        answer = by_qdd @ model.held_mobility
        self.rows[:, :m] = by_q - answer * model.stiffness
        self.rows[:, m : 2 * m] = by_qd - answer * model.damping
        self.rows[:, 2 * m : 3 * m] = answer
        model.carried = self._carried(robot, q, qd, qdd)
        self.rows[:, 3 * m + len(self.names) :] = answer @ model.shared(q[flexible])

    def _carried(self, robot: Robot, q: Array, qd: Array, qdd: Array) -> Array:
        """Return the forces (m, loads) on the amplitudes that the loads at the ends take."""
        found = np.zeros((len(robot.flexible_indices), self.loads))
        motion = robot.base_motion
        for column, heavier in enumerate(self._heavier):
            forces = []
            for one in (self._plain, heavier):
                one.move_base(motion)
                forces.append(
                    one.inverse_dynamics(q, qd, qdd, check=False)[robot.flexible_indices]
                )
            found[:, column] = (forces[0] - forces[1]) / CHANGE
        return found


def _ends(robot: Robot) -> list[str]:
    """Return the links of bodies that move and carry no other."""
    bodies = robot.tree.bodies
    carrying = {body.attachment.body for body in bodies}
    return [
        body.name
        for place, body in enumerate(bodies)
        if place not in carrying and body.name in robot.tree.frames
    ]


def _require(robot: Robot, names: tuple[str, ...], noise: Array) -> None:
    silent = [name for name, value in zip(names, noise, strict=True) if not value > 0.0]
    if silent:
        raise StateError(
            f'{robot.tree.name}: inertial sensors that are fused must have gyro_noise and '
            f'accel_noise > 0, got 0 for {", ".join(silent)}'
        )
    if names and robot.tree.loops:
        raise StateError(
            f'{robot.tree.name}: a robot whose inertial sensors are fused must have no loops, '
            f'got {", ".join(loop.name for loop in robot.tree.loops)}'
        )
