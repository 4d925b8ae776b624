"""Messages that the predictor publishes every tick, prebuilt."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState

from denoc_ros.bags.joint_state import JointStateMessage
from denoc_ros.dynamics.deflection import TipDeflections
from denoc_ros.estimation.observer import Observer
from denoc_ros.estimation.parameter_tracker import ParameterTracker
from denoc_ros.kernels.compiled import ready
from denoc_ros.kernels.rotation import write_quaternion
from denoc_ros.nodes.base import STATE, DenocNode
from denoc_ros.nodes.messages import PoseMessage, listeners, raw_publish
from denoc_ros.nodes.sensor_inputs import SensorInputs
from denoc_ros.types import Array

MOTION = ('position', 'velocity')


class PredictorOutputs:
    """Publishers and messages of tip deflections, tip pose, modal state and residuals.

    Parameters
    ----------
    node : DenocNode
        It publishes.
    coordinates : sequence of str
        Of the modal state.
    names : sequence of str
        Of the deflections.
    base_frame : str
        Of the pose's header.
    """

    def __init__(
        self, node: DenocNode, coordinates: Sequence[str], names: Sequence[str], base_frame: str
    ) -> None:
        self._node = node
        self._deflection = JointStateMessage(names, MOTION)
        self._ahead = JointStateMessage(names, MOTION)
        self._modal = JointStateMessage(coordinates, MOTION)
        bent, modal, ahead = self._deflection, self._modal, self._ahead
        self._deflection_arrays = bent.position, bent.velocity
        self._modal_arrays = modal.position, modal.velocity
        self._ahead_arrays = ahead.position, ahead.velocity
        self._pose = PoseMessage(base_frame)
        self._place = self._pose.values[:3]
        self._turned = self._pose.values[3:]
        ready(write_quaternion)
        self._residual = JointStateMessage((), ('position',))
        self._heard: tuple[str, ...] = ()
        self._parameters = JointStateMessage((), ('position', 'effort'))
        self._publishers: dict[str, Any] = {
            topic: node.create_publisher(JointState, f'~/{topic}', STATE)
            for topic in (
                'tip_deflection',
                'tip_deflection_predicted',
                'modal_state',
                'sensor_residual',
                'model_parameters',
            )
        }
        self._publishers['tip_pose'] = node.create_publisher(PoseStamped, '~/tip_pose', STATE)
        self._sends = {
            topic: raw_publish(publisher) for topic, publisher in self._publishers.items()
        }
        self._listeners = {
            topic: listeners(publisher) for topic, publisher in self._publishers.items()
        }

    def close(self) -> None:
        """Destroy the publishers."""
        for publisher in self._publishers.values():
            self._node.destroy_publisher(publisher)

    def has_listener(self, topic: str) -> bool:
        """Say whether anybody would receive a message: without listeners it is not computed."""
        return bool(self._listeners[topic]())

    def send_state(self, stamp_ns: int, observer: Observer) -> None:
        """Publish tip deflections and modal state, where somebody listens."""
        listeners = self._listeners
        if listeners['tip_deflection']():
            observer.deflections.evaluate(observer.q, observer.qd, out=self._deflection_arrays)
            self._send('tip_deflection', self._deflection, stamp_ns)
        if listeners['modal_state']():
            observer.modal_state(self._modal_arrays)
            self._send('modal_state', self._modal, stamp_ns)

    def send_ahead(self, stamp_ns: int, q: Array, qd: Array, deflections: TipDeflections) -> None:
        """Publish predicted tip deflections; the stamp is the time they are for."""
        deflections.evaluate(q, qd, out=self._ahead_arrays)
        self._send('tip_deflection_predicted', self._ahead, stamp_ns)

    def send_pose(self, stamp_ns: int, pose: Array) -> None:
        """Publish the pose (4, 4) of the deflected end effector."""
        self._place[:] = pose[:3, 3]
        write_quaternion(pose, self._turned)
        self._send('tip_pose', self._pose, stamp_ns)

    def send_residual(self, stamp_ns: int, sensors: SensorInputs, predicted: Array) -> None:
        """Publish measured minus predicted of the sensors heard so far."""
        gap = sensors.values - predicted
        heard = np.isfinite(gap)
        names = tuple(
            s.name for s, has in zip(sensors.sensors, heard.tolist(), strict=True) if has
        )
        if names != self._heard:
            self._heard = names
            self._residual = JointStateMessage(names, ('position',))
        self._residual.position[:] = gap[heard]
        self._send('sensor_residual', self._residual, stamp_ns)

    def send_parameters(self, stamp_ns: int, tracker: ParameterTracker) -> None:
        """Publish numbers of the model that are tracked: value and standard deviation."""
        if tracker.paths != self._parameters.names:
            self._parameters = JointStateMessage(tracker.paths, ('position', 'effort'))
        self._parameters.position[:] = tracker.values
        self._parameters.effort[:] = tracker.deviations
        self._send('model_parameters', self._parameters, stamp_ns)

    def _send(self, topic: str, message: JointStateMessage | PoseMessage, stamp_ns: int) -> None:
        message.stamp(stamp_ns)
        self._sends[topic](message.bytes())


def quaternion(rotation: Array) -> Array:
    """Return the quaternion x, y, z, w of a rotation (3, 3): w >= 0, or the first other > 0."""
    found = np.empty(4)
    write_quaternion(np.ascontiguousarray(rotation, dtype=np.float64), found)
    return found
