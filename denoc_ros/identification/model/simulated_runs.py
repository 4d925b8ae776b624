"""Residuals of all runs at a parameter vector, and their Jacobian."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import DenocError
from denoc_ros.estimation.joint_motion import SmoothedMotion
from denoc_ros.identification.model.free_parameters import FreeParameters, SearchPoint
from denoc_ros.identification.model.innovations import Motion, NearbyMotion
from denoc_ros.identification.model.prediction import PreparedRun
from denoc_ros.model.tree import RigidInertia
from denoc_ros.types import Array

STEP = 1e-4  # of the differences by theta
NEARBY = 0.003  # of theta: derivatives of a point this near take the same linear model
# rad of the fastest mode between two samples, up to which derivatives by the linear model of the
# amplitudes move numbers by less than a hundredth of their intervals
LINEAR_ANGLE = 0.2
SAME_BEYOND = 0.3  # of theta: so near, simulated derivatives differ alike from linear ones


class SimulatedRuns:
    """Residuals of all runs by theta, and their derivatives; the last results are kept.

    Attributes
    ----------
    until : float
        Part of the runs that matters: what is behind it is not worked out.
    is_followed : bool
        Whether the amplitudes have a linear model in all runs.
    is_linear : bool
        Whether that model is as good as simulations: no mode is near the sampling rate.
    """

    def __init__(self, runs: Sequence[PreparedRun], parameters: FreeParameters) -> None:
        self.parameters, self._runs = parameters, runs
        edges = np.cumsum([0, *(sum(len(c.t) for c in run.channels) for run in runs)])
        self._rows = [slice(int(a), int(b)) for a, b in pairwise(edges)]
        self._count = int(edges[-1])
        robot = parameters.robot
        self.is_followed = all(run.is_followed(robot) for run in runs)
        self.is_linear = self.is_followed and all(
            run.fastest_angle(robot) <= LINEAR_ANGLE for run in runs
        )
        self.until, self.evaluations = 1.0, 0
        self._noises: list[SmoothedMotion | None] = [None] * len(runs)  # on the joints' motion
        self._last: tuple[bytes, float, Array] | None = None
        self._motions: tuple[object, Robot, list[Motion]] | None = None
        self._nearby: tuple[float, Array, list[NearbyMotion]] | None = None
        self._slopes: tuple[object, Array] | None = None
        self._beyond: tuple[object, Array, Array] | None = None

    def residuals(self, theta: Array) -> Array:
        """Return all residuals in the units of their channels; not finite: no such robot."""
        key = (theta.tobytes(), self.until)
        if self._last is not None and self._last[:2] == key:
            return self._last[2]
        settings = self.parameters.settings(theta)
        try:
            robot, motions = self.moved(settings)
            parts = [
                each
                for run, motion in zip(self._runs, motions, strict=True)
                for each in run.residuals(robot, settings, motion)
            ]
        except DenocError:
            return np.full(self._count, np.nan)
        self._last = (*key, np.concatenate(parts))
        return self._last[2]

    def moved(self, settings: SearchPoint) -> tuple[Robot, list[Motion]]:
        """Return the robot of a point and its motion along each run.

        Delays, gains and offsets of channels move nothing, and friction of a joint that moves as
        recorded moves only its own torque: points that differ in those share the motion.
        """
        # torque of joints without effort is scaled by what balances in them, armature and all
        is_scaled = any(run.has_unpowered_joints for run in self._runs)
        moving = settings.overrides if is_scaled else self.parameters.moving(settings)
        own = SearchPoint(overrides=moving, bodies=settings.bodies)
        key = (self.until, repr(own.overrides), *(_bytes(body) for body in own.bodies.values()))
        if self._motions is None or self._motions[0] != key:
            self.evaluations += 1
            robot = self.parameters.robot_at(own)
            self._motions = key, robot, self._simulate(robot)
        return self._motions[1:]

    def linear_motions(self, theta: Array, within: float) -> list[NearbyMotion]:
        """Return the linear models of the amplitudes about the motions of a point.

        Those of a point that is within some distance have the same coefficients.
        """
        robot, motions = self.moved(self.parameters.settings(theta))
        kept = self._nearby
        if kept is None or kept[0] != self.until or np.abs(theta - kept[1]).max() > within:
            pairs = zip(self._runs, motions, strict=True)
            found = [run.nearby(robot, motion) for run, motion in pairs]
            self._nearby = self.until, theta.copy(), found
            return found
        return [each.about(motion) for each, motion in zip(kept[2], motions, strict=True)]

    def slopes_by_run(self, theta: Array, places: Sequence[int]) -> Array:
        """Return derivatives of the residuals (m, c) by numbers that move nothing."""
        motions = self.moved(self.parameters.settings(theta))[1]
        return self._differences(theta, places, lambda _: motions)

    def slopes_nearby(
        self, theta: Array, places: Sequence[int], within: float | None = None
    ) -> Array:
        """Return derivatives of the residuals (m, c), motions nearby by their linear model.

        The model is that of a point which is within some distance; default `NEARBY`.
        """
        nearby = self.linear_motions(theta, NEARBY if within is None else within)
        assert self._nearby is not None
        key = tuple(places), self.until, theta.tobytes(), self._nearby[1].tobytes()
        if self._slopes is None or self._slopes[0] != key:
            found = self._differences(
                theta, places, lambda robot: [each.of(robot) for each in nearby]
            )
            self._slopes = key, found
        return self._slopes[1]

    def slopes(self, theta: Array, places: Sequence[int]) -> Array:
        """Return derivatives of the residuals (m, c) as simulations have them.

        Those of the linear model come near; what simulations of all columns at a point have
        beyond them changes little, and serves at others as well.
        """
        linear = self.slopes_nearby(theta, places, 0.0)
        key, kept = (tuple(places), self.until), self._beyond
        if kept is None or kept[0] != key or np.abs(theta - kept[1]).max() > SAME_BEYOND:
            self.evaluations += int(self.parameters.moves_robot[list(places)].sum())
            found = self._differences(theta, places, self._simulate)
            self._beyond = kept = key, theta.copy(), found - linear
        return np.asarray(linear + kept[2])

    def _simulate(self, robot: Robot) -> list[Motion]:
        """Return the motions of a robot along the runs, with the noise that they have."""
        pairs = zip(self._runs, self._noises, strict=True)
        return [run.motion(robot, self.until, noise) for run, noise in pairs]

    def by_noise(self, theta: Array, draws: Sequence[np.random.Generator]) -> Array:
        """Return changes of the residuals (m, d) by noise of the joints from d generators.

        The linear model of the amplitudes gives those of the motion where it is as good.
        """
        here = self.residuals(theta)
        settings = self.parameters.settings(theta)
        robot, _ = self.moved(settings)
        nearby = self.linear_motions(theta, NEARBY) if self.is_linear else []
        self.evaluations += 0 if nearby else len(draws)
        found = np.empty((len(here), len(draws)))
        for k, (run, rows) in enumerate(zip(self._runs, self._rows, strict=True)):
            noises = list(run.noise(draws))
            motions = (
                nearby[k].shaken(robot, noises)
                if nearby
                else (run.motion(robot, self.until, noise) for noise in noises)
            )
            for column, motion in enumerate(motions):
                found[rows, column] = np.concatenate(run.residuals(robot, settings, motion))
        return found - here[:, None]

    def shaken(
        self, theta: Array, draw: np.random.Generator
    ) -> tuple[SimulatedRuns, SimulatedRuns]:
        """Return runs whose joints have noise on top, and those that have it with the other sign.

        Their motions and linear models at a point are ready; they serve no other point.
        """
        forth = [noise for run in self._runs for noise in run.noise([draw])]
        back = [SmoothedMotion(-noise.q, -noise.qd, -noise.qdd) for noise in forth]
        return self._with_noise(theta, forth), self._with_noise(theta, back)

    def _with_noise(self, theta: Array, noises: Sequence[SmoothedMotion]) -> SimulatedRuns:
        nearby = self.linear_motions(theta, NEARBY)
        assert self._motions is not None
        key, robot, _ = self._motions
        found = SimulatedRuns(self._runs, self.parameters)
        found.until, found._nearby, found._noises = self.until, self._nearby, [*noises]
        if self.is_linear:
            # What is linear in noise cancels: the rest needs the motion to second order.
            first = [
                own.about(motion)
                for own, noise in zip(nearby, noises, strict=True)
                for motion in own.shaken(robot, [noise])
            ]
            moved = [each.of(robot) for each in first]
        else:
            moved, found.evaluations = found._simulate(robot), 1
        found._motions = key, robot, moved
        return found

    def _differences(
        self, theta: Array, places: Sequence[int], motions_of: Callable[[Robot], list[Motion]]
    ) -> Array:
        """Derivatives of the residuals (m, c) by differences of neighbouring robots."""
        here = self.residuals(theta)
        settings = self.parameters.settings(theta)
        robot, motions = self.moved(settings)
        found = np.zeros((len(here), len(places)))
        of_robot, is_searched = self.parameters.moves_robot, self.parameters.is_searched
        # what moves nothing first: it shares what sensors see of the motion here
        for column, k in sorted(enumerate(places), key=lambda each: bool(of_robot[each[1]])):
            if not is_searched[k]:
                continue
            change = np.zeros(self.parameters.size)
            change[k] = STEP
            point = self.parameters.settings(theta + change)
            moved, those = robot, motions
            if of_robot[k]:
                moving = SearchPoint(overrides=self.parameters.moving(point), bodies=point.bodies)
                moved = self.parameters.robot_at(moving)
                those = motions_of(moved)
            own = self.parameters.runs[k]
            for run, motion, rows in zip(self._runs, those, self._rows, strict=True):
                if own in ('', run.name):
                    there = np.concatenate(run.residuals(moved, point, motion))
                    found[rows, column] = (there - here[rows]) / STEP
        return found


def _bytes(body: RigidInertia) -> bytes:
    return np.concatenate([[body.mass], body.first_moment, body.inertia.ravel()]).tobytes()
