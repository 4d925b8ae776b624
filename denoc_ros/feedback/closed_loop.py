"""The sampled closed loop of state feedback, its filter and its delays: does it settle?"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy.linalg

from denoc_ros.dynamics.robot import Robot
from denoc_ros.feedback.deviation_model import DeviationModel, PlannedState, deviation_model
from denoc_ros.feedback.feedback_design import PostureGains
from denoc_ros.feedback.feedback_settings import FeedbackSettings
from denoc_ros.types import Array

SHARES = (1.0, 0.8, 1.2)  # of the elastic stiffness, and of the load at the tip
FASTEST = 200.0  # Hz: faster modes of other robots are left out, they only cost time


@dataclass(frozen=True)
class Settling:
    """The slowest mode of a sampled closed loop.

    modulus of its eigenvalue per period, `frequency` [Hz]; `posture` (joints,) of the driven
    joints; shares of the elastic stiffness and of the load at the tip for which it is; `plant`
    names a robot with other modes than the design's, '' for none; `share` of the feedback that is
    in beside that of the joints.
    """

    modulus: float
    posture: Array
    stiffness: float
    load: float
    frequency: float = 0.0
    plant: str = ''
    share: float = 1.0

    def __str__(self) -> str:
        where = np.round(self.posture, 3).tolist()
        plant = f' of a robot with {self.plant}' if self.plant else ''
        return (
            f'modulus {self.modulus:.6f} at {self.frequency:.3g} Hz with {self.stiffness:g} of '
            f'the stiffness and {self.load:g} of the load{plant}, joints at {where}'
        )


def closed_loop(
    model: DeviationModel, gains: PostureGains, settings: FeedbackSettings, share: float = 1.0
) -> Array:
    """Return the transition over a period of plant, controller and filter together.

    Parameters
    ----------
    model : DeviationModel
        Of the plant, which need not be the one that the gains were made for, nor have its modes.
    gains : PostureGains
    settings : FeedbackSettings
    share : float
        Of the feedback that is in beside that of the joints.

    Returns
    -------
    (t, t) array
        Of [plant y; torques on their way; integrals; estimate; sensors' innovations on their way].
    """
    k, s, known_to = model.joints, 2 * model.size, len(gains.push)
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
    known = np.concatenate([corrected[:known_to], unit[way], unit[sums]])
    own = model.measured[: 2 * k] @ unit[plant]
    if not math.isfinite(settings.velocity_noise):
        own[k:] = gains.measured[k : 2 * k] @ corrected
    torque = -share * gains.gain @ known - gains.joints @ own
    pushes = np.concatenate([unit[way], torque])
    step = np.zeros((total, total))
    step[plant] = sampled.a[:s] @ unit[: s + past] + sampled.b[:s] @ torque
    step[way] = pushes[k:]
    half = known_to // 2
    step[sums] = unit[sums] + settings.period * gains.virtual @ corrected[:half]
    step[guess] = gains.transition @ corrected
    step[guess][:known_to] += gains.push @ pushes
    if waiting:
        # what is on its way is compared with an estimate that knows of what has come since
        rest = np.concatenate([unit[queue][sensors:], innovation[2 * k :]])
        rows = gains.measured[2 * k :]
        rest -= np.tile(rows @ by_sensors, (late, 1))
        rest[-sensors:] -= rows @ by_joints
        step[queue] = rest
    if not settings.integral_time or share < 1.0:  # integrals rest until all is in
        keep = np.delete(np.arange(total), np.arange(sums.start, sums.stop))
        step = step[np.ix_(keep, keep)]
    return step


def joint_loop(model: DeviationModel, gains: Array, settings: FeedbackSettings) -> Array:
    """Return the transition over a period of a plant with the joints' own feedback alone.

    Parameters
    ----------
    model : DeviationModel
    gains : (joints, 2 joints) array
        As :func:`denoc_ros.feedback.feedback_design.joint_gains` returns them.
    settings : FeedbackSettings

    Returns
    -------
    (t, t) array
        Of [plant y; torques on their way].
    """
    sampled = model.sampled(settings.period, settings.delay)
    step: Array = sampled.a.copy()
    step[:, : 2 * model.size] -= sampled.b @ gains @ model.measured[: 2 * model.joints]
    return step


def slow_modes(model: DeviationModel) -> DeviationModel:
    """Return a model without the modes of its links that are faster than `FASTEST`.

    Modes with the driven joints' inertia, at rest; what moves faster follows at once.
    """
    linear = model.linear
    values, shapes = scipy.linalg.eigh(np.diag(model.stiff), linear.inertia)
    kept = shapes[:, values <= (2.0 * np.pi * FASTEST) ** 2]
    into = scipy.linalg.block_diag(kept, kept)
    back = scipy.linalg.block_diag(kept.T @ linear.inertia, kept.T @ linear.inertia)
    reduced = replace(
        linear, a=back @ linear.a @ into, b=back @ linear.b, c=linear.c @ into,
        inertia=np.eye(kept.shape[1]),
    )  # fmt: skip
    return replace(
        model, linear=reduced, measured=model.measured @ into, tip=model.tip @ kept,
        stiff=np.zeros(0),
    )  # fmt: skip


def slowest_mode(step: Array, period: float) -> tuple[float, float]:
    """Return the modulus of the largest eigenvalue of a transition, and its frequency [Hz]."""
    values = np.linalg.eigvals(step)
    largest = values[np.argmax(np.abs(values))]
    return float(np.abs(largest)), float(np.abs(np.angle(largest)) / (2.0 * np.pi * period))


def plants(
    robot: Robot,
    joints: Sequence[str],
    sensors: Sequence[int],
    state: PlannedState,
    settings: FeedbackSettings,
) -> Iterator[tuple[DeviationModel, float, float]]:
    """Yield a robot's model at a moment with its stiffness and load off, and by how much."""
    for load in SHARES:
        loaded = robot if load == 1.0 else robot.with_scaled_load(settings.tip, load)
        model = deviation_model(loaded, joints, sensors, settings.tip, state)
        for stiffness in SHARES:
            yield model.varied(stiffness), stiffness, load
