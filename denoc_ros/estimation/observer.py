"""The observer of deflections from measured joints and strain, without ROS."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from denoc_ros.dynamics.base.base_motion import BaseMotion
from denoc_ros.dynamics.base.reacting_base import ReactingBase
from denoc_ros.dynamics.driven.driven_motion import driven_motion
from denoc_ros.dynamics.driven.measured_side import MotorSide, WholeCoordinates
from denoc_ros.dynamics.elastic.deflection import TipDeflections
from denoc_ros.dynamics.elastic.state_bounds import StateBounds
from denoc_ros.dynamics.equilibrium import Equilibrium, impulse_response
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.springs import CUTOFF, GearSprings
from denoc_ros.dynamics.stepper import Stepper, raise_step_status
from denoc_ros.errors import SolverError
from denoc_ros.estimation.fusion import StrainFusion
from denoc_ros.estimation.joint_tracker import TrackingFilter, joining_acceleration
from denoc_ros.estimation.observer_settings import ObserverSettings
from denoc_ros.kernels.dynamics.articulated import articulated_dynamics
from denoc_ros.kernels.dynamics.driven_step import BANDWIDTH, INTERVAL, MEASURED, SHORTEST, STEP
from denoc_ros.kernels.dynamics.driven_step import MOST_STEPS as MOST
from denoc_ros.kernels.jit.compiled import entry
from denoc_ros.types import Array

Reference = Callable[[float], tuple[Array, Array, Array]]
BaseAt = Callable[[float], BaseMotion | None]

# A longer gap [s] is not integrated over: the observer goes on from the measurement instead.
LONGEST_GAP = 0.25
MOST_STEPS = 250  # between two measurements, however far apart


@dataclass(frozen=True)
class MeasuredState:
    """An observer's state at a measurement."""

    stamp: float
    rows: tuple[Array, ...]


class Observer:
    """Observer of a flexible robot's amplitudes, by measurements of its joints and sensors.

    A state at the last measurement has been driven by what was measured up to there, however late
    that came; from it the state now, and `horizon` ahead, is predicted anew.

    Parameters
    ----------
    robot : Robot
        The model; the observer works on copies.
    settings : ObserverSettings
        How.
    joints : sequence of str, optional
        The joints that are measured, in the order of all arrays of joints here; default all that
        are not mimics. Mimic joints follow their leaders, loops give the joints they bind, and
        any other stands still at 0.
    posture : (n,) array, optional
        Coordinates near which loops are closed; default 0.

    Attributes
    ----------
    q, qd : (n,) arrays
        Estimated coordinates and rates at `time`.
    q_ahead, qd_ahead : (n,) arrays
        The same, `horizon` ahead, after `predict`.
    time : float
        Time of the estimate [s]; NaN before the first measurement.
    late, repeated, restarts, unsettled : int
        Measurements refused as too old, and as not newer than the last one; gaps that were not
        integrated over; undeformed starts, where there was no equilibrium.
    robot : Robot
        The observer's own.
    deflections : TipDeflections
        The tips' displacements from amplitudes.
    springs : GearSpringEstimator
        The springs behind which joints are measured.
    fusion : StrainFusion or None
        What takes the sensors' values in, if they are fused.
    bounds : StateBounds
        Of every estimated or predicted state.

    Raises
    ------
    StateError
        Sensors are to be fused, but there are none or one has no noise; the measured joints do
        not determine the motion of the loops.
    SolverError
        Loops do not close near the posture.
    """

    def __init__(
        self,
        robot: Robot,
        settings: ObserverSettings,
        joints: Sequence[str] | None = None,
        posture: Array | None = None,
    ) -> None:
        self.settings = settings
        self.robot = robot.copy()
        self.motion = driven_motion(self.robot, joints, None, posture)
        self._stepper = Stepper(robot.copy(), settings.step, self.motion.given)
        self._joints, self._flexible = self.motion.index, robot.flexible_indices
        self._free = np.union1d(robot.free_indices, self.motion.bound)
        self._floating = ReactingBase(self.robot)
        self._floats = self._floating.floats
        self._max_age, self._step = settings.max_age, settings.step
        self._horizon_steps = settings.horizon_steps
        if settings.fusion is not None:
            self._floating.require_none('where sensors are fused')
        self._equilibrium = Equilibrium(self.robot, self._free)
        self.bounds = StateBounds(self.robot, self.motion.posture, self._free)
        self._filter = TrackingFilter(len(self._joints), settings.cutoff)
        self.deflections = TipDeflections(robot)
        self.springs = GearSpringEstimator(self.robot, self.motion.joints, settings)
        self.q, self.qd, self.q_ahead, self.qd_ahead = np.zeros((4, robot.n))
        self._q, self._qd = np.zeros((2, robot.n))  # at the last measurement
        self._held = robot.held(robot.joint_indices)
        self._articulated = entry(articulated_dynamics)
        self._tau = np.zeros(robot.n)  # efforts, and loads that sensors show
        self.fusion: StrainFusion | None = None
        self._alone: Observer | None = None  # by the joints alone: no sensor can disturb it
        if settings.fusion is not None:
            self._alone = Observer(robot, replace(settings, fusion=None), joints, posture)
            self.fusion = StrainFusion(
                robot,
                settings.step,
                settings.fusion,
                settings.max_age,
                self._free if settings.source == 'joints' else np.arange(robot.n),
                self._measured_accelerations,
                self._uncertainty,
            )
        self._base: BaseAt | None = None
        if robot.tree.sensors and not robot.tree.loops:  # nothing is made in the loop
            self.robot.beyond_shapes(self.q, self.q, self.q)
        # numbers of a measurement, as kernels take them
        self._numbers = np.zeros(MEASURED)
        self._numbers[BANDWIDTH] = self._filter.bandwidth
        self._numbers[SHORTEST] = 2.5 * settings.step  # of several ticks
        self._numbers[STEP], self._numbers[MOST] = settings.step, MOST_STEPS
        self._still = np.zeros(len(self.motion.given))
        # what sensors show is the same in all steps to the next measurement
        self._steady = self.fusion is None or self.fusion.is_steady
        # s up to which one call leads to the next measurement; sensors' values want each step
        self._in_one = LONGEST_GAP if self.fusion is None else (1.0 + 1e-6) * settings.step
        self._simple = (
            settings.source == 'joints'
            and self.motion.plain
            and self._steady
            and not (self._stepper.tied or self._floating.floats or self.springs.hidden)
        )
        self.late = self.repeated = self.restarts = self.unsettled = 0
        self.reset()

    @property
    def base(self) -> BaseAt | None:
        """Motion of the base at a time on the clock of `tick` [s]; None: it is at rest."""
        return self._base

    @base.setter
    def base(self, base: BaseAt | None) -> None:
        self._base = base
        if self._alone is not None:
            self._alone.base = base

    def reset(self) -> None:
        """Forget the state; the next measurement starts the observer again."""
        if self._alone is not None:
            self._alone.reset()
        self.time = math.nan
        self._stamp = math.nan
        self._tau[:] = 0.0

    def rehearse(self) -> None:
        """Call all that a loop calls once, so that nothing compiles in it; then reset."""
        step, index = self.settings.step, self.motion.index
        there, still = self.motion.posture[index], np.zeros(len(index))
        self.measure(0.0, there, still, still)
        self.measure(step, there, still, still)
        # One of each value: what inertial sensors need compiles here.
        for place in range(len(self.fusion.names) if self.fusion else 0):
            self.sense(place, step, 0.0)
        self.tick(2.0 * step)
        count = len(self.springs.whole.names)
        self.modal_state((np.empty(count), np.empty(count)))
        self.predict()
        self.reset()

    @property
    def stamp(self) -> float:
        """Time of the last measurement [s]; NaN before the first."""
        return self._stamp

    def measured_state(self) -> MeasuredState | None:
        """Return the state to `rewind` to; None if sensors or hidden springs have states too."""
        if self.fusion is not None or self.springs.hidden or not self.started:
            return None
        rows = self._q, self._qd, self._tau, self._filter.state
        return MeasuredState(self._stamp, tuple(row.copy() for row in rows))

    def rewind(self, state: MeasuredState) -> None:
        """Go back to the state at an earlier measurement."""
        self.time = self._stamp = state.stamp
        rows = self._q, self._qd, self._tau, self._filter.state
        for row, before in zip(rows, state.rows, strict=True):
            row[:] = before

    @property
    def started(self) -> bool:
        """Whether a measurement has started the observer."""
        return self.time == self.time  # no NaN

    @property
    def stale(self) -> bool:
        """Whether the last measurement is older than `max_age`."""
        return self.time - self._stamp > self._max_age

    @property
    def is_current(self) -> bool:
        """Whether the observer has been started, and is not stale."""
        return self.time - self._stamp <= self._max_age  # False of NaN

    def measure(
        self, stamp: float, q: Array, qd: Array | None = None, effort: Array | None = None
    ) -> bool:
        """Take a measurement of the joints in.

        The first one starts the observer, with the amplitudes in static equilibrium.

        Parameters
        ----------
        stamp : float
            When it was taken [s], on the clock of `tick`.
        q, qd : (joints,) arrays
            Positions and, if known, rates.
        effort : (joints,) array, optional
            Torques or forces at the joints [N m, N]; kept until the next. Of joints measured
            behind their springs, what the gears give out (`motor_effort`: the motors).

        Returns
        -------
        bool
            False if it was refused: too old, or not newer than the last one.
        """
        if self.time != self.time:  # no measurement has started it
            self._start(stamp, q, qd)
            self._measure_alone(stamp, q, qd)
            self.take_effort(effort)
            self._follow_springs((self._q, self._qd), 0.0)
            return True
        if not stamp > self._stamp:
            self.repeated += 1
            return False
        if self.time - stamp > self._max_age:
            self.late += 1
            return False
        interval = stamp - self._stamp
        self._measure_alone(stamp, q, qd)
        if self._simple and self.base is None and interval <= self._in_one:
            rates = q if qd is None else qd
            if self.fusion is not None:
                self._load(self._q, self._qd)
            self._numbers[INTERVAL] = interval
            self._stepper.measure(
                self._numbers, self._filter.state, (q, rates), qd is not None,
                self._tau, self._q, self._qd,
            )  # fmt: skip
            self._stamp = stamp
            if self.fusion is not None:
                self._follow(0.0)
                self._fuse()
            if effort is not None:
                self.take_effort(effort)
            return True
        before = self._q.copy(), self._qd.copy()
        self._filter.update(q, qd, interval)
        self._drive(interval)
        self._stamp = stamp
        self._fuse()
        self.take_effort(effort)
        self._follow_springs(before, interval)
        return True

    def _measure_alone(self, stamp: float, q: Array, qd: Array | None) -> None:
        """Let the estimate by the joints alone take the measurement too."""
        if self._alone is not None and self.fusion is not None:
            self._alone.measure(stamp, q, qd)
            self.fusion.follow_joints(stamp, self._alone._q, self._alone._qd)

    def _follow_springs(self, before: tuple[Array, Array], interval: float) -> None:
        """Let the springs behind measured joints go on from a state (n,) before to this one."""
        if not self.springs.hidden:
            return
        if self.springs.by_effort:
            self.springs.take(self._tau, interval)
            return
        if self.base is not None:
            self._stepper.robot.move_base(self.base(self._stamp - 0.5 * interval))
        given = self.motion.given_accelerations(self._filter.mean)
        states = before, (self._q, self._qd)
        self.springs.follow(self._stepper, states, given, self._tau, interval)

    def sense(self, place: int, stamp: float, value: float) -> bool:
        """Take a sensor's value in; it counts once joints measured as late are known.

        Parameters
        ----------
        place : int
            Of the value among `fusion.names`: sensors on beams, then inertial sensors' values.
        stamp : float
            When it was measured [s], on the clock of `tick`.
        value : float
            Calibrated.

        Returns
        -------
        bool
            False if it was refused, or sensors are not fused, or nothing has started.
        """
        fusion = self.fusion
        if fusion is None or self.time != self.time:  # no measurement has started it
            return False
        return fusion.sense(place, stamp, value)

    def _fuse(self) -> None:
        if self.fusion is not None:
            self.fusion.correct(self._q, self._qd)
            if len(self.motion.bound):
                self.motion.positions(self._q, self._q[self._joints])
                self.motion.rates(self._qd, self._qd[self._joints])
            self._load(self._q, self._qd)

    def _load(self, q: Array, qd: Array, ahead: float = 0.0) -> None:
        """Let the forces act that sensors show, so long after a state (n,) [s]."""
        fusion = self.fusion
        if fusion is not None:
            forces = fusion.loads if self._steady else fusion.forces(q, qd, ahead)
            self._tau[self._flexible] = forces

    def _measured_accelerations(self, time: float, q: Array, qd: Array) -> tuple[Robot, Array]:
        """Return the robot at a time, and its accelerations (n,)."""
        self._load(q, qd)
        return self.robot, self._accelerate(self.robot, time, q, qd)

    def _uncertainty(self) -> Array:
        """Return the deviations (n,) of the joints' measured accelerations."""
        deviation = np.zeros(self.robot.n)
        unsteady = self.motion.given_accelerations(np.sqrt(self._filter.unsteady))
        deviation[self.robot.joint_indices] = np.abs(unsteady)
        return deviation

    def _accelerate(self, robot: Robot, time: float, q: Array, qd: Array) -> Array:
        """Return the accelerations (n,) by the joints' measured ones and the present loads."""
        if self.base is not None:
            robot.move_base(self.base(time))
        qdd, given, torque = np.zeros((3, robot.n))
        joints = robot.joint_indices
        wanted = self.motion.given_accelerations(self._filter.qdd)
        given[joints] = wanted
        status = self._articulated(
            robot.handle, robot.armature, self._held, q, qd, given, self._tau, qdd, torque
        )
        raise_step_status(robot, status, q, qd, given, self._tau)
        qdd[joints] = wanted
        return qdd

    def joint_torque(self) -> Array:
        """Return the torques (joints,) that the motion takes at the last measurement [N m, N]."""
        q, qd = self._q, self._qd
        qdd = self._accelerate(self.robot, self._stamp, q, qd)
        torque = self.robot.inverse_dynamics(q, qd, qdd, check=False)
        return np.asarray(torque[self._joints])

    @property
    def judges_effort(self) -> bool:
        """Whether `joint_torque` is what measured efforts are."""
        sides = self.springs.hidden or self.settings.motor_effort or self._floating.floats
        return self.motion.plain and self.fusion is None and not sides

    def sensor_values(self, robot: Robot) -> Array:
        """Return the values (sensors,) that the model expects of sensors on beams at `time`.

        On robots with loops they are those of the beams' shapes. `robot` is the observer's, or a
        copy of it for another thread.
        """
        q, qd = self.q.copy(), self.qd.copy()
        if robot.tree.loops or not self.started:
            return robot.beam_sensor_values(q)
        return robot.beam_sensor_values(q, qd, self._accelerate(robot, self.time, q, qd))

    def take_effort(self, effort: Array | None) -> None:
        """Take efforts (joints,) [N m, N] in, from a measurement or another way; None: none."""
        if self._alone is not None:
            self._alone.take_effort(effort)
        if effort is not None:
            motion = self._filter.qd, self._filter.qdd
            self._tau[self._joints] = self.springs.gear_torque(effort, motion)

    def retune(self, change: Callable[[Robot], None]) -> None:
        """Let numbers of the model change: a function changes those of a robot."""
        change(self.robot)
        change(self._stepper.robot)
        if self._alone is not None:
            self._alone.retune(change)
        if self.fusion is not None:
            self.fusion.filter.retune(change)

    def adopt(self, other: Observer) -> None:
        """Go on from the state of another observer of a robot with the same coordinates."""
        for name in ('q', 'qd', '_q', '_qd', '_tau'):
            getattr(self, name)[:] = getattr(other, name)
        self._filter.adopt(other._filter)
        self.springs.adopt(other.springs)
        if self._alone is not None:
            self._alone.adopt(other if other._alone is None else other._alone)
        self.time, self._stamp = other.time, other._stamp
        if self.fusion is not None and not self.fusion.adopt(other.fusion) and self.started:
            self.fusion.reset(self._stamp, self._q, self._qd)
        self.late, self.repeated = other.late, other.repeated
        self.restarts, self.unsettled = other.restarts, other.unsettled

    def _start(self, stamp: float, q: Array, qd: Array | None) -> None:
        self.time = self._stamp = stamp
        if self.base is not None:
            self.robot.move_base(self.base(stamp))
        self._filter.reset(q, qd)
        self._q[:] = self.motion.posture
        self.motion.positions(self._q, q)
        undeformed = self._q.copy()
        try:
            # a base that floats falls freely: nothing has a weight
            if len(self._free) and not self._floating.floats:
                self._equilibrium.find(self._q)
        except SolverError:  # buckled at this posture: nothing is known of the amplitudes
            self.unsettled += 1
            self._q[:] = undeformed
        self._qd[:] = 0.0
        self._follow_joints()
        if self._floating.floats:
            self._floating.rates(self._q, self._qd)
        self.q[:], self.qd[:] = self._q, self._qd
        if self.fusion is not None:
            self.fusion.reset(stamp, self._q, self._qd)

    def _drive(self, interval: float) -> None:
        """Bring the state from the measurement before over an interval [s] to this one."""
        if interval > LONGEST_GAP:
            self.restarts += 1
            self.springs.reset()
            if self.fusion is not None:
                self.fusion.restart(self._stamp + interval, self._q, self._qd)
        elif self.settings.source == 'torque':
            self._go(self._q, self._qd, self._stamp, interval, None, self._follow)
            self._correct(interval)
            return
        else:
            joints, measured = self._joints, self._filter
            before, after = (self._q[joints], self._qd[joints]), (measured.q, measured.qd)
            shortest = 2.5 * self.settings.step  # of several ticks
            way = joining_acceleration(interval, before, after, shortest)
            self._go(self._q, self._qd, self._stamp, interval, way, self._follow)
        self._follow_joints()

    def _follow_joints(self) -> None:
        """Set the joints to their measured positions, and the dependent joints with them."""
        self.motion.positions(self._q, self._filter.q)
        self.motion.rates(self._qd, self._filter.qd)

    def _correct(self, interval: float) -> None:
        """Pull the joints towards the measured motion, the amplitudes as by an impulse there.

        So do the joints that loops bind.
        """
        gain = -math.expm1(-2.0 * math.pi * self.settings.correction_cutoff * interval)
        joints, motion = self._joints, self.motion
        motion.positions(self._q, self._q[joints] + gain * (self._filter.q - self._q[joints]))
        jump = np.zeros(self.robot.n)
        motion.rates(jump, gain * (self._filter.qd - self._qd[joints]))
        self._qd += impulse_response(self.robot, self._q, self._free, jump)

    def _go(
        self,
        q: Array,
        qd: Array,
        begin: float,
        duration: float,
        acceleration: Callable[[float], Array] | None,
        follow: Callable[[float], None] | None = None,
        most: int = MOST_STEPS,
    ) -> None:
        """Advance a state of time `begin` in place, joints by an acceleration or by the effort.

        After each step `follow` hears how far it has gone [s].
        """
        steps = min(most, max(1, math.ceil(duration / self.settings.step - 1e-6)))
        step = duration / steps
        self._stepper.step = step
        moves, fuses = self.base is not None, self.fusion is not None
        for index in range(steps):
            if moves:
                self._move_base(begin + (index + 0.5) * step)
            if fuses:
                self._load(q, qd, 0.5 * step)
            if acceleration is None:
                self._stepper.free(q, qd, self._tau)
            else:
                given = self.motion.given_accelerations(acceleration((index + 0.5) * step))
                self._stepper.driven(q, qd, given, self._tau)
            if fuses and follow is not None:
                follow((index + 1) * step)
        if self._floating.floats:
            self._floating.wrap(q, qd)

    def _coast(
        self, start: tuple[Array, Array], q: Array, qd: Array, duration: float, most: int
    ) -> None:
        """Advance from a state to q and qd with the joints' accelerations as last measured."""
        steps = math.ceil(duration / self._step - 1e-6)
        if steps > most:
            steps = most
        given = self.motion.given_accelerations(self._filter.qdd)
        self._stepper.drive(q, qd, given, self._still, duration, steps or 1, self._tau, start)
        if self._floats:
            self._floating.wrap(q, qd)

    def _move_base(self, time: float) -> None:
        assert self.base is not None
        self._stepper.robot.move_base(self.base(time))

    def _follow(self, gone: float) -> None:
        """Let the fusion know the state so long after the last measurement."""
        if self.fusion is not None:
            self.fusion.follow(self._stamp + gone, self._q, self._qd)

    def tick(self, now: float) -> None:
        """Bring the estimate to a time [s]; nothing before the first measurement.

        The joints go on from the last measurement with the acceleration they had, for `max_age`
        at most: `stale` from then on. A time before the last measurement counts as that.

        Raises
        ------
        StateError
            The estimate is none that the robot can have; `reset` starts the observer again.
        """
        if self.time != self.time:  # no measurement has started it
            return
        if self.fusion is not None:
            self._fuse()
        stamp, q, qd, most = self._stamp, self.q, self.qd, self._horizon_steps
        self.time = now if now > stamp else stamp
        lead = now - stamp
        if lead > self._max_age:
            lead = self._max_age
        if lead > 0.0 and self._steady and self.base is None:
            self._coast((self._q, self._qd), q, qd, lead, most)
        else:
            q[:], qd[:] = self._q, self._qd
            if lead > 0.0:
                self._go(q, qd, stamp, lead, lambda _: self._filter.qdd, most=most)
        self.bounds.require(q, qd)

    def modal_state(self, out: tuple[Array, Array]) -> None:
        """Write coordinates and rates of the whole robot at `time`: see GearSpringEstimator."""
        if not self.springs.hidden:
            out[0][:], out[1][:] = self.q, self.qd
            return
        lead = min(self.time - self._stamp, self._max_age)
        self.springs.write((self.q, self.qd), lead, out)

    def predict(self, reference: Reference | None = None) -> tuple[Array, Array]:
        """Predict the state `horizon` ahead.

        Parameters
        ----------
        reference : callable, optional
            `t -> (q, qd, qdd)` of the joints, on the clock of `tick`: they are taken to move on
            with its accelerations. None: with those measured last.

        Returns
        -------
        pair of (n,) arrays
            `q_ahead`, `qd_ahead`: overwritten by the next call.

        Raises
        ------
        StateError
            The prediction is none that the robot can have.
        """
        horizon, most = self.settings.horizon, self.settings.horizon_steps
        q, qd = self.q_ahead, self.qd_ahead
        if horizon > 0.0 and reference is None and self._steady and self.base is None:
            self._coast((self.q, self.qd), q, qd, horizon, most)
        else:
            q[:], qd[:] = self.q, self.qd
            if horizon > 0.0:
                begin = self.time

                def expected(t: float) -> Array:
                    return self._filter.qdd if reference is None else reference(begin + t)[2]

                self._go(q, qd, begin, horizon, expected, most=most)
        self.bounds.require(q, qd)
        return q, qd


# springs behind which joints are measured -------------------------------------------------------

State = tuple[Array, Array]


class GearSpringEstimator:
    """Estimates s and s' of the springs behind which joints are measured.

    Parameters
    ----------
    robot : Robot
        As of :class:`WholeCoordinates`; its workspace is used.
    joints : sequence of str
        That are measured.
    settings : ObserverSettings
        `cutoff` is the bandwidth of the filter on the gears' torque, at most 100 Hz.

    Attributes
    ----------
    whole : WholeCoordinates
    hidden : tuple of str
        The joints.
    by_effort : bool
        Whether the gears' torque is measured.

    Notes
    -----
    The links' motion, which is measured, takes a torque t of the gear, and that bends the spring:
    k s + d s' = -t. With the source `torque` t is the effort that was measured behind the gear.
    The motor's own dynamics do not enter.
    """

    def __init__(self, robot: Robot, joints: Sequence[str], settings: ObserverSettings) -> None:
        self._robot = robot
        self.whole = WholeCoordinates(robot)
        self.hidden = self.whole.hidden
        self._springs = GearSprings(self.whole.springs, min(settings.cutoff, CUTOFF))
        self._motors = MotorSide(robot, joints) if settings.motor_effort else None
        self.by_effort = settings.source == 'torque' and not settings.motor_effort
        self._qdd, self._force = np.zeros((2, robot.n))
        self._ahead = 0.0  # s from the instant of the last torque to the last measurement

    def reset(self) -> None:
        """Forget all: the springs start at rest."""
        self._springs.reset()

    def adopt(self, other: GearSpringEstimator) -> None:
        """Go on from the state of another robot's with the same joints."""
        self._springs.adopt(other._springs)
        self._ahead = other._ahead

    def gear_torque(self, effort: Array, motion: State) -> Array:
        """Output torque of the gears (joints,) by efforts, rates and accelerations of links."""
        if self._motors is None:
            return effort
        torque = np.array(effort, dtype=np.float64)
        self._motors.take_off(torque, motion)
        return torque

    def follow(
        self, stepper: Stepper, states: tuple[State, State], given: Array, tau: Array,
        interval: float,
    ) -> None:  # fmt: skip
        """Go on to the next measurement by the torque that the motion up to there takes.

        Parameters
        ----------
        stepper : Stepper
            Of a robot whose base is where it was in the middle.
        states : pair of pairs of (n,) arrays
            Coordinates and rates before and after.
        given : (given joints,) array
            Accelerations in between.
        tau : (n,) array
            Loads that sensors show.
        interval : float
            [s]; 0: the springs start at rest.
        """
        (q_before, qd_before), (q, qd) = states
        if not len(self._robot.base_indices):  # a rotation vector may jump
            q, qd = 0.5 * (q_before + q), 0.5 * (qd_before + qd)
        stepper.accelerations(q, qd, given, self._qdd, tau)
        stepper.robot.inverse_dynamics(q, qd, self._qdd, out=self._force, check=False)
        self.take(self._force, interval)
        self._ahead = 0.5 * interval

    def take(self, force: Array, interval: float) -> None:
        """Go on by the gears' torques of generalized forces (n,) of the last measurement."""
        self._springs.follow(force[self.whole.places], interval)
        self._ahead = 0.0

    def write(self, described: State, ahead: float, out: State) -> None:
        """Write the whole robot's coordinates and rates from those described.

        Parameters
        ----------
        described : pair of (n,) arrays
            Coordinates and rates of the robot that joint states describe.
        ahead : float
            How long after the last measurement they are [s].
        out : pair of arrays
            Written, in the order of `whole.names`. Of joints measured behind their springs they
            have the motor's side.
        """
        rate = self._springs.rate
        lead = self._ahead + ahead
        self.whole.write(described[0], self._springs.deflection + lead * rate, out[0])
        self.whole.write(described[1], rate, out[1])
