"""How many functions of the package stand between a message's arrival, the kernel and publish."""

from __future__ import annotations

import sys
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from feedforward_bench import FeedforwardBench, joint_state, point
from node_robots import JOINTS

import denoc_ros

pytestmark = pytest.mark.ros

PACKAGE = str(Path(denoc_ros.__file__).parent)
MOST = 12  # what a reader can hold


def chain() -> list[str]:
    """Return the package's functions that the caller's caller runs in, the innermost first."""
    frame: FrameType | None = sys._getframe(2)
    names = []
    while frame is not None:
        if frame.f_code.co_filename.startswith(PACKAGE):
            names.append(frame.f_code.co_name)
        frame = frame.f_back
    return names


class Spy:
    """Calls what it stands for, and keeps the longest chain of calls that came to it.

    Attributes
    ----------
    longest : list of str
    seen : set of str
        All functions of all chains.
    """

    def __init__(self, spied: Any) -> None:
        self.spied = spied
        self.longest: list[str] = []
        self.seen: set[str] = set()

    def __call__(self, *arguments: Any) -> Any:
        found = chain()
        self.seen |= set(found)
        self.longest = max(self.longest, found, key=len)
        return self.spied(*arguments)


@pytest.mark.parametrize('trigger', ['clock', 'message'])
def test_few_calls_lead_from_a_message_to_the_kernel_and_back(
    graph: Any, urdf: str, trigger: str
) -> None:
    streamed = {'reference_source': 'joint_states'} if trigger == 'message' else {}
    arm = FeedforwardBench(graph, urdf, trigger=trigger, **streamed)
    robot, output = arm.node.torque.source.robot, arm.node.output
    robot._inverse = kernel = Spy(robot._inverse)
    output._publish_effort = publish = Spy(output._publish_effort)
    if trigger == 'clock':
        arm.follow(point(0.0, [0.0, 0.0]), point(5.0, [0.5, -0.6]))
    else:
        for k in range(5):
            arm.states.publish(joint_state(JOINTS, [0.0, 0.0], 10**7 * (k + 1)))
            graph.spin(0.01)
    arm.until(lambda: '_joint_torque' in kernel.seen and publish.longest)
    for longest in (kernel.longest, publish.longest):
        assert len(longest) <= MOST, longest
