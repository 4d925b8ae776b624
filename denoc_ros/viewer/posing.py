"""Joint sliders of a page, for a robot without a run."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.mechanism_modes import independent_joints
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import DenocError
from denoc_ros.model.lowering import is_flexible
from denoc_ros.model.tree import Joint, JointKind
from denoc_ros.viewer.modes import settled
from denoc_ros.viewer.moment import Moment
from denoc_ros.viewer.outline import reach

Array = NDArray[np.float64]

SLIDE_STEPS = 400  # of a slider; one that turns has one per degree
SAGGING = 0.2  # of a beam's length: more sag than that is none of a robot made for the ground


def start_configuration(robot: Robot) -> Array:
    """Return a configuration (n,) to begin with: zero, or a closed one near it."""
    zero = np.zeros(robot.n)
    if not len(robot.lowered.tie_names):
        return zero
    try:
        return robot.assemble(zero)
    except DenocError:
        return zero


class JointSliders:
    """The folder of a page that moves joints; what loops bind follows.

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
        self, gui: Any, robot: Robot, start: Array, draw: Callable[[Moment], None]
    ) -> None:
        self._robot, self._guard = robot.copy(), threading.Lock()
        self._draw, self.q = draw, start.copy()
        self._held = independent_joints(robot, start)
        self._folder = gui.add_folder('Joints', order=30.0)
        joints = {body.joint.name: body.joint for body in robot.tree.bodies if body.joint}
        self._sliders: dict[int, tuple[Any, float]] = {}
        with self._folder:
            for name, index in zip(self._held, robot.indices(self._held), strict=True):
                joint = joints[name]
                unit, size = ('m', 1.0) if slides(joint) else ('deg', math.degrees(1.0))
                low, high = (size * end for end in _range(joint, reach(robot)))
                step = (high - low) / SLIDE_STEPS if slides(joint) else 1.0
                value = min(max(size * float(start[index]), low), high)
                slider = gui.add_slider(f'{name} [{unit}]', low, high, step, value)
                slider.on_update(lambda _: self.move())
                self._sliders[index] = slider, size
            self._sag = gui.add_checkbox(
                'Sag under gravity',
                _stands(robot, settled(robot, start)),
                hint='Links in equilibrium, else undeflected',
            )
            self._text = gui.add_markdown('')
        self._sag.on_update(lambda _: self.move())

    def move(self) -> None:
        """Go where the sliders stand."""
        with self._guard:
            try:
                self.q = self._pose()
            except DenocError as error:
                self._text.content = f'does not close: {error}'
                return
        self._text.content = ''
        self._draw(Moment(0.0, self.q))

    def _pose(self) -> Array:
        robot = self._robot
        guess = self.q.copy()
        guess[robot.flexible_indices] = 0.0
        for index, (slider, size) in self._sliders.items():
            guess[index] = slider.value / size
        if len(robot.lowered.tie_names):
            guess = robot.assemble(guess, fixed=self._held)
        return settled(robot, guess) if self._sag.value else guess

    def close(self) -> None:
        """Take the folder away."""
        self._folder.remove()


def slides(joint: Joint) -> bool:
    """Return whether a joint is one of metres."""
    return joint.kind is JointKind.PRISMATIC


def _stands(robot: Robot, q: Array) -> bool:
    """Return whether beams bend no more than they might in a robot made for this gravity."""
    beams = [(body.name, body.beam) for body in robot.tree.bodies if is_flexible(body)]
    return all(
        np.linalg.norm(robot.tip_deflection(name, q)) <= SAGGING * beam.length
        for name, beam in beams
        if beam is not None
    )


def _range(joint: Joint, size: float) -> tuple[float, float]:
    """Return the slider's ends: the joint's limits, within a turn or the robot's size."""
    most = size if slides(joint) else math.pi
    low, high = max(joint.limits.lower, -most), min(joint.limits.upper, most)
    return (float(low), float(high)) if high > low else (-most, most)
