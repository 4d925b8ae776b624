"""The sampled closed loop of state feedback, its filter and its delays: does it settle?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from denoc_ros.control.deviation_model import DeviationModel, PlannedState, deviation_model
from denoc_ros.control.feedback_design import PostureGains
from denoc_ros.control.feedback_settings import FeedbackSettings
from denoc_ros.dynamics.measured_side import MeasuredStates
from denoc_ros.dynamics.robot import Robot
from denoc_ros.types import Array

SHARES = (1.0, 0.8, 1.2)  # of the elastic stiffness, and of the load at the tip


@dataclass(frozen=True)
class Settling:
    """The slowest mode of a sampled closed loop.

    modulus of its eigenvalue per period; `posture` (joints,) of the driven joints; shares of the
    elastic stiffness and of the load at the tip for which it is.
    """

    modulus: float
    posture: Array
    stiffness: float
    load: float

    def __str__(self) -> str:
        where = np.round(self.posture, 3).tolist()
        return (
            f'modulus {self.modulus:.6f} with {self.stiffness:g} of the stiffness and '
            f'{self.load:g} of the load, joints at {where}'
        )


def closed_loop(model: DeviationModel, gains: PostureGains, settings: FeedbackSettings) -> Array:
    """Return the transition over a period of plant, controller and filter together.

    Parameters
    ----------
    model : DeviationModel
        Of the plant, which need not be the one that the gains were made for.
    gains : PostureGains
    settings : FeedbackSettings

    Returns
    -------
    (t, t) array
        Of [plant y; torques on their way; integrals; estimate; sensors' innovations on their way].
    """
    k, s = model.joints, 2 * model.size
    sampled = model.sampled(settings.period, settings.delay)
    past, e = len(sampled.a) - s, len(gains.transition)
    seen = len(model.measured)
    late = round(settings.sensor_delay / settings.period)
    sensors = seen - 2 * k
    waiting = late * sensors
    total = s + past + k + e + waiting
    ends = np.cumsum([0, s, past, k, e, waiting])
    plant, way, sums, guess, queue = (slice(*pair) for pair in pairwise(ends.tolist()))
    unit = np.eye(total)
    innovation = model.measured @ unit[plant] - gains.measured @ unit[guess]
    arriving = innovation.copy()
    if waiting:
        arriving[2 * k :] = unit[queue][:sensors]
    by_joints = gains.correction[:, : 2 * k] @ arriving[: 2 * k]
    by_sensors = gains.correction[:, 2 * k :] @ arriving[2 * k :]
    corrected = unit[guess] + by_joints + by_sensors
    known = np.concatenate([corrected[:s], unit[way], unit[sums]])
    torque = -gains.gain @ known
    pushes = np.concatenate([unit[way], torque])
    step = np.zeros((total, total))
    step[plant] = sampled.a[:s] @ unit[: s + past] + sampled.b[:s] @ torque
    step[way] = pushes[k:]
    step[sums] = unit[sums] + settings.period * gains.virtual @ corrected[: model.size]
    step[guess] = gains.transition @ corrected
    step[guess][:s] += gains.push @ pushes
    if waiting:
        # what is on its way is compared with an estimate that knows of what has come since
        rest = np.concatenate([unit[queue][sensors:], innovation[2 * k :]])
        rows = gains.measured[2 * k :]
        rest -= np.tile(rows @ by_sensors, (late, 1))
        rest[-sensors:] -= rows @ by_joints
        step[queue] = rest
    if not settings.integral_time:
        keep = np.delete(np.arange(total), np.arange(sums.start, sums.stop))
        step = step[np.ix_(keep, keep)]
    return step


def settling(
    robot: Robot,
    joints: Sequence[str],
    sensors: Sequence[int],
    states: Sequence[PlannedState],
    gains: Sequence[PostureGains],
    settings: FeedbackSettings,
) -> Settling:
    """Return the slowest mode over all postures and all variations of the model.

    Parameters
    ----------
    robot, joints, sensors
        As of :func:`denoc_ros.control.deviation_model.deviation_model`.
    states, gains : sequences
        The postures and what the loop has there.
    settings : FeedbackSettings
    """
    seen = MeasuredStates(robot, joints)
    return max(
        (
            Settling(_modulus(varied, gain, settings), seen.posture(state.q), stiffness, load)
            for state, gain in zip(states, gains, strict=True)
            for varied, stiffness, load in _variations(robot, joints, sensors, state, settings)
        ),
        key=lambda one: one.modulus,
    )


def _variations(
    robot: Robot,
    joints: Sequence[str],
    sensors: Sequence[int],
    state: PlannedState,
    settings: FeedbackSettings,
) -> Iterator[tuple[DeviationModel, float, float]]:
    for load in SHARES:
        loaded = robot if load == 1.0 else robot.with_scaled_load(settings.tip, load)
        model = deviation_model(loaded, joints, sensors, settings.tip, state)
        for stiffness in SHARES:
            yield model.varied(stiffness), stiffness, load


def _modulus(model: DeviationModel, gains: PostureGains, settings: FeedbackSettings) -> float:
    values = np.linalg.eigvals(closed_loop(model, gains, settings))
    return float(np.abs(values).max())
