"""Joint sliders of a page, for a robot without a run."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from denoc_ros.dynamics.mechanism_modes import independent_joints
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import DenocError
from denoc_ros.model.tree import Joint, JointKind
from denoc_ros.types import Array
from denoc_ros.viewer.modes import settled
from denoc_ros.viewer.outline import reach
from denoc_ros.viewer.snapshot import Snapshot

SLIDE_STEPS = 400  # of a slider; one that turns has one per degree
TOO_MUCH = 'drawn straight: in this gravity links bend more than small deflections'


def start_configuration(robot: Robot, joints: Mapping[str, float] | None = None) -> Array:
    """Return a configuration (n,) to begin with: the joints given, zero else, loops closed."""
    q = np.zeros(robot.n)
    given = joints or {}
    q[robot.indices(tuple(given))] = list(given.values())
    if not len(robot.constraint_names):
        return q
    try:
        q = robot.assemble(q)
    except DenocError:
        return q
    if not robot.tree.mimics:
        for body in robot.tree.bodies:  # the same, within a turn: what a slider has
            if body.joint is not None and body.joint.kind is JointKind.REVOLUTE:
                (index,) = robot.indices([body.joint.name])
                q[index] = math.remainder(q[index], 2.0 * math.pi)
    return q


class JointSliders:
    """The folder of a page that moves joints; joints bound by loops follow.

    Parameters
    ----------
    gui : viser's gui
    robot : Robot
    start : (n,) array
        Where it begins.
    draw : callable
        Draws a moment.
    """

    def __init__(
        self, gui: Any, robot: Robot, start: Array, draw: Callable[[Snapshot], None]
    ) -> None:
        self._robot, self._guard = robot.copy(), threading.Lock()
        self._draw, self.q = draw, start.copy()
        self._held = independent_joints(robot, start)
        self._folder = gui.add_folder('Joints', order=30.0)
        self._sliders: dict[int, tuple[Any, float]] = {}
        with self._folder:
            for name, index in zip(self._held, robot.indices(self._held), strict=True):
                joint = robot.tree.joints[name]
                unit, size = ('m', 1.0) if slides(joint) else ('deg', math.degrees(1.0))
                low, high = (size * end for end in _range(joint, reach(robot)))
                step = (high - low) / SLIDE_STEPS if slides(joint) else 1.0
                value = min(max(size * float(start[index]), low), high)
                slider = gui.add_slider(f'{name} [{unit}]', low, high, step, value)
                slider.on_update(lambda _: self.move())
                self._sliders[index] = slider, size
            self._sag = gui.add_checkbox(
                'Sag under gravity',
                True,
                hint='Links in equilibrium, else straight',
                visible=bool(len(robot.flexible_indices)),
            )
            self._text = gui.add_markdown('')
        self._sag.on_update(lambda _: self.move())

    def move(self) -> None:
        """Go where the sliders stand."""
        with self._guard:
            try:
                self.q, self._text.content = self._pose()
            except DenocError as error:
                self._text.content = f'does not close: {error}'
                return
        self._draw(Snapshot(0.0, self.q))

    def _pose(self) -> tuple[Array, str]:
        """Configuration of the sliders, and a message about it."""
        robot = self._robot
        guess = self.q.copy()
        guess[robot.flexible_indices] = 0.0
        for index, (slider, size) in self._sliders.items():
            guess[index] = slider.value / size
        if len(robot.constraint_names):
            guess = robot.assemble(guess, fixed=self._held)
        if not self._sag.value:
            return guess, ''
        rest = settled(robot, guess)
        return (guess, TOO_MUCH) if rest is None else (rest, '')

    def close(self) -> None:
        """Take the folder away."""
        self._folder.remove()


def slides(joint: Joint) -> bool:
    """Return whether a joint is one of metres."""
    return joint.kind is JointKind.PRISMATIC


def _range(joint: Joint, size: float) -> tuple[float, float]:
    """Return the slider's ends: the joint's limits, within a turn or the robot's size."""
    most = size if slides(joint) else math.pi
    low, high = max(joint.limits.lower, -most), min(joint.limits.upper, most)
    return (float(low), float(high)) if high > low else (-most, most)
