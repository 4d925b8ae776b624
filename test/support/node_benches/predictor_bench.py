"""A predictor under test, the swing of the arm that it follows, and the messages it is given."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from planar_chains import PlanarLink
from sensor_msgs.msg import JointState

import denoc_ros as dn
from denoc_ros.nodes.predictor import PredictorNode
from denoc_ros.simulation.simulate import Run

DOWN = (0.0, -9.81, 0.0)
ARM = (PlanarLink(1.0, 2.0, 60.0), PlanarLink(0.8, 1.0))
GAUGE = (
    '<sensor name="root" type="strain_gauge" link="link_1" station="0.05" direction="y"'
    ' surface="0.01" gain="2.0e-6" offset="1.0e-5" topic="/strain/root"/>'
)
RATE = 200.0  # Hz of the joint states and of the node


def swing(robot_file: Path) -> Run:
    """Return 1.5 s of a swing of both joints, with the true amplitudes."""
    robot = dn.load_robot(robot_file, gravity=DOWN)

    def law(t: float) -> tuple[float, float, float]:
        return 0.2 * (1 - np.cos(4 * t)), 0.8 * np.sin(4 * t), 3.2 * np.cos(4 * t)

    return dn.simulate(
        robot,
        robot.static_deflection([0.0, 0.0]),
        np.zeros(robot.n),
        np.linspace(0.0, 1.5, 301),
        prescribed=dict.fromkeys(robot.joint_names, law),
        rtol=1e-7,
    )


def joint_state(run: Run, row: int, stamp_ns: int, effort: bool = False) -> JointState:
    joints = [run.coordinate_names.index(name) for name in ('joint_2', 'joint_1')]
    message = JointState(name=['joint_2', 'joint_1'])
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    message.position = run.q[row, joints].tolist()
    message.velocity = run.qd[row, joints].tolist()
    if effort:
        message.effort = run.torque[row, joints].tolist()
    return message


def add(graph: Any, robot_file: Path, **parameters: Any) -> Any:
    return graph.add(
        PredictorNode,
        urdf_path=str(robot_file),
        gravity=list(DOWN),
        update_rate=RATE,
        joint_state_timeout=0.3,
        **parameters,
    )


def begun(node: Any) -> Any:
    """Return a node that was added with `start=False`, active: the test calls its ticks from 0."""
    node.trigger_configure()
    node.begin()
    node._now = 0.0
    return node
