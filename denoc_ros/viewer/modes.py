"""The mode player of a page: natural modes at a configuration, one at a time."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from denoc_ros.dynamics.equilibrium import Equilibrium
from denoc_ros.dynamics.natural_modes import NaturalModes, independent_joints, mechanism_modes
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import DenocError
from denoc_ros.model.arrays import is_flexible
from denoc_ros.model.segments import whole_beams
from denoc_ros.types import Array
from denoc_ros.viewer.outline import reach
from denoc_ros.viewer.snapshot import Snapshot
from denoc_ros.viewer.ticker import Ticker

PERIOD = 1.0 / 30.0  # s between two pictures
QUICKEST = 1.0  # Hz: faster modes are shown as slowly as this
SWING = 0.04  # of the robot's reach, or this angle [rad]: the largest amplitude shown
STILL = 'none'
MOST_SAG = 0.2  # of a beam's length


class ModeShapes:
    """Natural modes with joints held and loops closed, in equilibrium where there is one.

    Parameters
    ----------
    robot : Robot
        Not shared with another thread.
    q : (n,) array
        A configuration; its joints are what counts.

    Attributes
    ----------
    q : (n,) array
        The configuration that the modes are about.
    found : NaturalModes
    labels : list of str
    """

    def __init__(self, robot: Robot, q: Array) -> None:
        rest = settled(robot, q)
        self.q = undeflected(robot, q) if rest is None else rest
        self.found: NaturalModes = mechanism_modes(
            robot, self.q, independent_joints(robot, self.q)
        )
        pairs = zip(self.found.frequencies, self.found.damping_ratios, strict=True)
        self.labels = [
            f'{k}: {frequency:.4g} Hz, damping {100.0 * ratio:.3g} %'
            for k, (frequency, ratio) in enumerate(pairs, start=1)
        ]
        self._size = _sizes(robot)

    def shown_frequency(self, k: int) -> float:
        """Return the frequency at which a mode is shown [Hz]."""
        return float(min(max(abs(self.found.frequencies[k]), 0.2), QUICKEST))

    def at(self, k: int, t: float) -> Array:
        """Return the coordinates (n,) of a mode's swing at a time [s] of the show."""
        shape = self.found.shapes[:, k]
        swing = shape / np.abs(shape / self._size).max()
        return np.asarray(self.q + math.sin(2.0 * math.pi * self.shown_frequency(k) * t) * swing)


def settled(robot: Robot, q: Array) -> Array | None:
    """Return a configuration (n,) with all that joints leave free in equilibrium, loops closed.

    None where there is no equilibrium, or one whose deflections are none of small-deflection
    theory: a robot made for space in this gravity.
    """
    held = independent_joints(robot, q)
    free = np.setdiff1d(np.arange(robot.n), robot.indices(held))
    rest: Array = q.copy()
    rest[robot.flexible_indices] = 0.0
    if not len(robot.flexible_indices):
        return rest
    try:
        if len(robot.constraint_names):
            rest = robot.assemble(rest, fixed=held)
        Equilibrium(robot, free).find(rest)
    except DenocError:
        return None
    small = all(
        np.linalg.norm(robot.tip_deflection(beam.link, rest)) <= MOST_SAG * beam.length
        for beam in whole_beams(robot.tree)
        if beam.segments == 1
    )
    return rest if small else None


def undeflected(robot: Robot, q: Array) -> Array:
    """Return a configuration (n,) with straight links, its loops closed where they can be."""
    rest: Array = q.copy()
    rest[robot.flexible_indices] = 0.0
    if not len(robot.constraint_names):
        return rest
    try:
        return robot.assemble(rest, fixed=independent_joints(robot, q))
    except DenocError:
        return rest


def _sizes(robot: Robot) -> Array:
    """Largest swing of each coordinate: a length, an angle for joints and twist."""
    turns, slides = SWING * math.pi, SWING * reach(robot)
    sizes = np.full(robot.n, turns)
    for body in robot.tree.bodies:
        if is_flexible(body):
            if body.modes is not None:
                sizes[robot.amplitudes(body.name)] = SWING * body.spans
                continue
            assert body.beam is not None
            first = robot.amplitudes(body.name).start
            sizes[first : first + sum(body.beam.modes[:2])] = slides
    return sizes


class ModePlayer:
    """The folder of a page that finds and plays modes.

    Parameters
    ----------
    gui : viser's gui
    robot : Robot
    where : callable
        Returns the coordinates (n,) to find modes at.
    draw : callable
        Draws a moment while a mode plays, with the deflection as it is.
    leave : callable
        Called when none plays any longer.
    """

    def __init__(
        self,
        gui: Any,
        robot: Robot,
        where: Callable[[], Array],
        draw: Callable[[Snapshot], None],
        leave: Callable[[], None],
    ) -> None:
        self._robot, self._guard = robot.copy(), threading.Lock()
        self._where, self._draw, self._leave = where, draw, leave
        self._modes: ModeShapes | None = None
        self._chosen = -1
        self._t = 0.0
        self._ticker = Ticker(PERIOD, self._tick)
        self._folder = gui.add_folder(
            'Natural modes', order=40.0, visible=bool(len(robot.flexible_indices))
        )
        with self._folder:
            self._find = gui.add_button('Find here', hint='At the joint positions shown now')
            self._choice = gui.add_dropdown('Mode', [STILL], initial_value=STILL)
            self._text = gui.add_markdown('')
        self._find.on_click(lambda _: self.find())
        self._choice.on_update(lambda _: self._choose())

    @property
    def playing(self) -> bool:
        """Whether a mode plays."""
        return self._chosen >= 0

    def find(self) -> None:
        """Find the modes where the robot is."""
        self._choice.value = STILL
        try:
            with self._guard:
                self._modes = ModeShapes(self._robot, self._where())
        except DenocError as error:
            self._modes = None
            self._text.content = str(error)
            return
        self._choice.options = (STILL, *self._modes.labels)
        count = len(self._modes.labels)
        self._text.content = f'{count} modes, joints held' if count else 'no link bends'

    def close(self) -> None:
        """Stop, and take the folder away."""
        self._ticker.stop()
        self._chosen = -1
        self._folder.remove()

    def _choose(self) -> None:
        modes = self._modes
        label = self._choice.value
        if modes is None or label not in modes.labels:
            self._ticker.stop()
            if self.playing:
                self._chosen = -1
                self._leave()
            return
        self._chosen, self._t = modes.labels.index(label), 0.0
        frequency = modes.found.frequencies[self._chosen]
        shown = modes.shown_frequency(self._chosen)
        slower = abs(frequency) / shown
        self._text.content = f'shown {slower:.3g} times slower' if slower > 1.01 else ''
        self._ticker.start()

    def _tick(self, passed: float) -> None:
        modes, chosen = self._modes, self._chosen
        if modes is not None and chosen >= 0:
            self._t += passed
            self._draw(Snapshot(self._t, modes.at(chosen, self._t)))
