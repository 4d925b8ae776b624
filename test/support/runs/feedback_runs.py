"""A robot that is not its model, under the torque of a plan with state feedback."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from data_files import CLAMPED_FREE_CANADARM

import denoc_ros as dn
from denoc_ros.dynamics.driven.measured_side import MeasuredStates, measured_robot
from denoc_ros.dynamics.driven.torque_feedforward import TorqueFeedforward
from denoc_ros.dynamics.robot import Robot
from denoc_ros.export.mujoco_robot import MujocoRobot, MujocoSettings
from denoc_ros.feedback.feedback_settings import FeedbackSettings
from denoc_ros.feedback.gain_jobs import GainJob
from denoc_ros.feedback.gain_schedule import GainSchedule
from denoc_ros.feedback.read_values import numbered_values
from denoc_ros.feedback.residual_modes import is_hardened
from denoc_ros.feedback.state_feedback import StateFeedback
from denoc_ros.model.overrides import edited_description
from denoc_ros.simulation.simulated_robot import Drives, ModalRobot, SimulatedRobot
from denoc_ros.trajectories import CycloidalTrajectory, SplineTrajectory
from denoc_ros.types import Array

# gains and bounds of these tests are those of this robot
CANADARM = CLAMPED_FREE_CANADARM
Measured = tuple[int, Array, Array, Array]  # period, coordinates, rates, accelerations
PERIOD = 1e-3
DELAY = 1.5  # periods
SUBSTEPS = 2  # per period, so that the torque changes within one
START, WAY = np.radians([10.0, 40.0, 30.0]), np.radians([60.0, 45.0, 30.0])
AFTER = 5.0  # s
ROTORS = {'joint_1': 300.0, 'joint_2': 150.0, 'joint_3': 20.0}  # kg m^2


@dataclass(frozen=True, eq=False)
class Planned:
    """A plan as the feedforward has it: per period all coordinates, their rates, the torque."""

    robot: Robot  # with all its springs
    trajectory: SplineTrajectory
    q: Array
    qd: Array
    qdd: Array
    torque: Array
    effort: float = 5000.0  # N m
    period: float = PERIOD  # s

    @property
    def duration(self) -> float:
        return self.trajectory.duration

    @property
    def limits(self) -> Array:
        return np.full(len(self.robot.joint_names), self.effort)

    @cached_property
    def tip(self) -> Array:
        """Return where the tip is at the end of each period (k, 3) [m]."""
        return self.robot.frame_pose('tool', self.q[1:])[:, :3, 3]

    def schedule(self, **more: float) -> GainSchedule:
        return designed(self, **more)


@cache
def designed(planned: Planned, **more: float) -> GainSchedule:
    """Return the gains along a plan; nothing changes them."""
    period = planned.period
    settings = FeedbackSettings(period=period, tip='tool', delay=DELAY * period, **more)
    robot, trajectory = planned.robot, planned.trajectory
    idle = np.zeros(robot.n)
    job = GainJob(robot.joint_names, planned.limits, idle, settings, START, trajectory)
    return job.schedule(robot)


def canadarm(stiffness: float = 1.0, load: float = 1.0, source: str = str(CANADARM)) -> Robot:
    """Return the planar Canadarm with gauges, no gravity, its stiffness and third link off."""
    robot = dn.load_robot(_loaded(source, load), gravity=(0.0, 0.0, 0.0))
    rigidity = {'beam.link_1.y.ei': 1e5 * stiffness, 'beam.link_2.y.ei': 2e5 * stiffness}
    return robot.with_overrides(rigidity)


def _loaded(source: str, load: float) -> str:
    """Return a description, or the text of a file, with the inertia of the third link scaled."""
    text = source if source.startswith('<') else Path(source).read_text()
    robot = ElementTree.fromstring(text)
    found = robot.find('link[@name="link_3"]/inertial')
    assert found is not None
    for part in ('mass', 'inertia'):
        numbers = found.find(part)
        assert numbers is not None
        for name, value in numbers.items():
            numbers.set(name, repr(load * float(value)))
    return ElementTree.tostring(robot, encoding='unicode')


@cache
def described(
    shape: str = 'craig-bampton', modes: int = 2, segments: int = 1, rotors: bool = True
) -> str:
    """Return the Canadarm with other beams, and with rotor inertia of 1 % of its own."""
    found: dict[str, float | str] = {}
    for link in ('link_1', 'link_2'):
        found |= {f'beam.{link}.shape': shape, f'beam.{link}.y.modes': modes}
        if segments > 1:
            found[f'beam.{link}.segments'] = segments
    for joint, inertia in ROTORS.items():
        found[f'joint.{joint}.armature'] = inertia if rotors else 0.0
    return edited_description(str(CANADARM), found)


@cache
def tip_exact(
    duration: float = 10.0, share: float = 1.0, source: str = str(CANADARM), period: float = PERIOD
) -> Planned:
    """Return the tip-exact plan of the Canadarm's cycloid, or of a share of its way."""
    robot = canadarm(source=source)
    cycloid = CycloidalTrajectory(START, share * WAY / duration, np.full(3, duration))
    times, positions, _, _ = cycloid.table(0.05)
    plan = dn.shape_motion(robot, times, positions, tip='tool')
    joints = plan.q[:, robot.joint_indices]
    return planned_along(robot, SplineTrajectory(plan.t - plan.t[0], joints), period=period)


def planned_along(
    robot: Robot, trajectory: SplineTrajectory, after: float = AFTER, effort: float = 5000.0,
    period: float = PERIOD,
) -> Planned:  # fmt: skip
    """Return the plan along a motion of the measured joints, and for so long after it [s]."""
    count = round((trajectory.duration + after) / period) + 1
    source = TorqueFeedforward(measured_robot(robot), None, 'flexible', step=period)
    rows = np.zeros((3, count, robot.n))
    torque = np.zeros((count, len(robot.joint_names)))
    q, qd, qdd = np.zeros((3, len(robot.joint_names)))
    for k in range(count):
        trajectory.sample(k * period, q, qd, qdd)
        torque[k] = source.update(q, qd, qdd, period if k else 0.0)
        rows[:, k] = source.whole_motion()
    return Planned(robot, trajectory, rows[0], rows[1], rows[2], torque, effort, period)


@dataclass
class Outcome:
    """Distance of the tip from the plan's (k,) [m], torque (k, joints), share of the feedback."""

    error: Array
    torque: Array
    share: Array
    moving: int  # periods of the plan's motion
    period: float  # s

    @property
    def rms(self) -> float:
        return float(np.sqrt(np.mean(self.error[: self.moving] ** 2)))

    def after(self, seconds: float) -> float:
        return float(self.error[self.moving + round(seconds / self.period) :].max())


@dataclass
class Loop:
    """The closed loop, advanced period by period."""

    planned: Planned
    truth: Robot
    feedback: StateFeedback | None
    seed: int = 1
    lost: float = 0.0  # share of the sensors' values
    silent: tuple[float, float] = (np.inf, np.inf)  # s, when the first sensor says nothing
    gone: tuple[float, float] = (np.inf, np.inf)  # s, when no torque leaves
    noise: float = 1.0
    stall: float = 0.0  # share of ticks that begin a pause of up to 20 periods
    away: dict[float, float] = field(default_factory=dict)  # s of pauses by their begin [s]
    joints_alone: bool = False  # no sensor is heard: the joints' own feedback
    # what the first sensor says of a value at a time [s]
    wrong: Callable[[float, float], float] | None = None
    backlog: int = 0  # ticks after a pause in which what was measured in it arrives
    # force (3,) [N] on the tip by its place and velocity (3,), world axes
    contact: Callable[[Array, Array], Array] | None = None
    delay: float = DELAY  # periods from a measurement to its torque, as they are
    waits: float = 0.0  # s at rest with feedback before the motion
    hinges: int = 0  # per beam of a truth that MuJoCo simulates; 0: its own modes

    def __post_init__(self) -> None:
        self._states = MeasuredStates(self.truth)
        # gauges read the moment of what lies beyond; those of robots that have the model's own
        # modes, and no rotors, the model's own shapes
        self._by_moments = is_hardened(self.planned.robot, self.planned.robot.joint_names)
        self._unread: list[Measured] = []
        self.values = numbered_values(self.truth.tree)
        self._sensors = [value.name.partition('/')[0] for value in self.values]
        rng = np.random.default_rng(1000 + self.seed)
        self.biases = [value.bias * rng.standard_normal() for value in self.values]

    def run(self, duration: float | None = None) -> Outcome:
        plan, truth, period = self.planned, self.truth, self.planned.period
        whole = len(plan.q) - 1
        count = whole if duration is None else min(whole, round(duration / period))
        joints, tau = len(truth.joint_names), np.zeros(truth.n)
        simulated = self._plant = self._simulated()
        q, qd, qdd = simulated.q, simulated.qd, np.zeros(truth.n)
        queue = deque([plan.torque[0]] * round(self.delay * SUBSTEPS))
        before = round(self.waits / period)  # ticks
        torque, share = np.zeros((before + count, joints)), np.zeros(before + count)
        chain = simulated if isinstance(simulated, MujocoRobot) else None
        reached = np.empty((before + count, truth.n if chain is None else 3))
        generator = np.random.default_rng(self.seed)
        paused = part = 0
        pauses = {round(at / period): round(long / period) for at, long in self.away.items()}
        for tick in range(before + count):
            k = tick - before
            paused = pauses.get(k, paused)
            if self.stall and paused == 0 and generator.random() < self.stall:
                paused = int(generator.integers(1, 20))
            if paused:
                # the drives hold what they were last told
                paused, torque[tick] = paused - 1, torque[tick - 1]
                self._unread.append((k, q.copy(), qd.copy(), qdd.copy()))
                part = -(-len(self._unread) // max(1, self.backlog))  # that a tick reads
            else:
                measured = k, q, qd, qdd
                if self.backlog and self._unread:
                    measured = self._unread[:part][-1]
                del self._unread[:part]
                torque[tick] = self._torque(k, measured, generator)
            share[tick] = self.feedback.share if self.feedback else 0.0
            for _ in range(SUBSTEPS):
                queue.append(torque[tick])
                tau[:] = self._touched(q, qd)
                tau[truth.joint_indices] += queue.popleft()
                simulated.free(tau)
                qdd[:] = simulated.qdd
            reached[tick] = q if chain is None else chain.data.site('tool').xpos
        reached = reached[before:]
        there = reached if chain else truth.frame_pose('tool', reached)[:, :3, 3]
        error = np.linalg.norm(there - plan.tip[:count], axis=1)
        return Outcome(
            error, torque[before:], share[before:], round(plan.duration / period), period
        )

    def _readings(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Return what the truth's sensors measure (sensors,)."""
        if isinstance(self._plant, MujocoRobot):
            values: Array = self._plant.sensor_values()
            return values
        return self.truth.sensor_values(q, qd, qdd if self._by_moments else None)

    def _touched(self, q: Array, qd: Array) -> Array | float:
        """Generalized forces (n,) of what the tip touches."""
        if self.contact is None:
            return 0.0
        jacobian = self.truth.frame_jacobian('tool', q)[:3]
        force = self.contact(self.truth.frame_pose('tool', q)[:3, 3], jacobian @ qd)
        return np.asarray(jacobian.T @ force)

    def _simulated(self) -> SimulatedRobot:
        """Return the truth at the plan's beginning."""
        plan, truth, step = self.planned, self.truth, self.planned.period / SUBSTEPS
        start = plan.q[0][plan.robot.joint_indices]
        drives = Drives(truth.joint_names, truth.joint_indices, *np.zeros((2, len(start))))
        at = truth.static_deflection(start)
        if self.hinges:
            chosen = MujocoSettings(self.hinges, static=False)
            chain: SimulatedRobot = MujocoRobot(truth, truth.tree, step, at, drives, chosen)
            return chain
        simulated = ModalRobot(truth, step, at, drives)
        if truth.coordinate_names == plan.robot.coordinate_names:
            simulated.q[:], simulated.qd[:] = plan.q[0], plan.qd[0]
        return simulated

    def _torque(self, k: int, measured: Measured, generator: np.random.Generator) -> Array:
        """Return what leaves in a period (joints,): the plan's torque and the feedback's."""
        plan, feedback, period = self.planned, self.feedback, self.planned.period
        now, stamp, q, qd, qdd = k * period, measured[0] * period, *measured[1:]
        k = max(k, 0)
        if feedback is None:
            return np.asarray(plan.torque[k])
        if self.gone[0] <= now < self.gone[1]:
            feedback.rest()
            return np.zeros_like(plan.torque[k])
        settings, joints = feedback.schedule.settings, len(self.truth.joint_names)
        normal = self.noise * generator.standard_normal(2 * joints + len(self.values))
        feedback.follow(now, plan.q[k], plan.qd[k], plan.qdd[k] if self._by_moments else None)
        feedback.filter.take_joints(
            stamp,
            self._states.posture(q) + settings.position_noise * normal[:joints],
            self._states.posture(qd) + settings.velocity_noise * normal[joints : 2 * joints],
        )
        readings, said, gone = self._readings(q, qd, qdd), '', False
        for place, (value, bias) in enumerate(zip(self.values, self.biases, strict=True)):
            if self._sensors[place] != said:  # the values of one come and go together
                said = self._sensors[place]
                silent = said == self._sensors[0] and self.silent[0] <= now < self.silent[1]
                gone = generator.random() < self.lost or silent
            if not gone and not self.joints_alone:
                reading = readings[value.place] + bias + value.noise * normal[2 * joints + place]
                if place == 0 and self.wrong is not None:
                    reading = self.wrong(now, reading)
                feedback.filter.take_sensor(place, stamp, reading)
        wanted = plan.torque[k] + feedback.torque(now, plan.torque[k])
        left = np.clip(wanted, -plan.limits, plan.limits)
        feedback.applied(left - plan.torque[k])
        return np.asarray(left)


def closed(planned: Planned, truth: Robot, **more: float) -> Loop:
    """Return a loop with the feedback of given settings."""
    return Loop(planned, truth, StateFeedback(planned.robot, planned.schedule(**more)))
