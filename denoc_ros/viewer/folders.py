"""Folders of a page: natural modes, joint sliders, playback of a run."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from denoc_ros.dynamics.equilibrium import Equilibrium
from denoc_ros.dynamics.linear.natural_modes import (
    NaturalModes,
    independent_joints,
    mechanism_modes,
)
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import DenocError
from denoc_ros.model.arrays import is_flexible
from denoc_ros.model.beams.segments import whole_beams
from denoc_ros.model.tree import Joint, JointKind
from denoc_ros.simulation.recorded.snapshot import Snapshot
from denoc_ros.types import Array
from denoc_ros.viewer.outline import reach
from denoc_ros.viewer.page_text import PageText

PERIOD = 1.0 / 30.0  # s between two pictures
QUICKEST = 1.0  # Hz: faster modes are shown as slowly as this
SWING = 0.04  # of the robot's reach, or this angle [rad]: the largest amplitude shown
NO_MODE = 'none'
MOST_SAG = 0.2  # of a beam's length
SLIDE_STEPS = 400  # of a slider; one that turns has one per degree
TOO_MUCH = 'drawn straight: in this gravity links bend more than small deflections'
SPEEDS = ('0.1', '0.25', '0.5', '1', '2', '5')
STEP = 1e-3  # s, of the slider


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
            self._choice = gui.add_dropdown('Mode', [NO_MODE], initial_value=NO_MODE)
            self._text = PageText(gui)
        self._find.on_click(lambda _: self.find())
        self._choice.on_update(lambda _: self._choose())

    @property
    def playing(self) -> bool:
        """Whether a mode plays."""
        return self._chosen >= 0

    def find(self) -> None:
        """Find the modes where the robot is."""
        self._choice.value = NO_MODE
        try:
            with self._guard:
                self._modes = ModeShapes(self._robot, self._where())
        except DenocError as error:
            self._modes = None
            self._text.show(str(error))
            return
        self._choice.options = (NO_MODE, *self._modes.labels)
        count = len(self._modes.labels)
        self._text.show(f'{count} modes, joints held' if count else 'no link bends')

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
        self._text.show(f'shown {slower:.3g} times slower' if slower > 1.01 else '')
        self._ticker.start()

    def _tick(self, passed: float) -> None:
        modes, chosen = self._modes, self._chosen
        if modes is not None and chosen >= 0:
            self._t += passed
            self._draw(Snapshot(self._t, modes.at(chosen, self._t)))


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
    """The folder of a page that moves joints; joints bound by loops follow."""

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
            self._text = PageText(gui)
        self._sag.on_update(lambda _: self.move())

    def move(self) -> None:
        """Go where the sliders stand."""
        with self._guard:
            try:
                self.q, said = self._pose()
            except DenocError as error:
                self._text.show(f'does not close: {error}')
                return
            self._text.show(said)
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


class Playback:
    """The folder of a page that goes through a run.

    Parameters
    ----------
    watched : callable
        Says whether anybody looks: the run waits else.
    """

    def __init__(
        self,
        gui: Any,
        run: Sequence[Snapshot],
        draw: Callable[[Snapshot], None],
        watched: Callable[[], bool],
    ) -> None:
        self._run, self._draw, self._watched = run, draw, watched
        self.times = np.array([moment.t for moment in run])
        self._start, self._end = float(self.times[0]), float(self.times[-1])
        self._ticker = Ticker(PERIOD, self._tick)
        self._folder = gui.add_folder('Run', order=0.0)
        with self._folder:
            self._slider = gui.add_slider(
                'Time [s]', self._start, max(self._end, self._start + STEP), STEP, self._start
            )
            self._button = gui.add_button('Play')
            self._speed = gui.add_dropdown('Speed', SPEEDS, initial_value='1')
            self._again = gui.add_checkbox('Again and again', False)
        self._slider.on_update(lambda _: self.show())
        self._button.on_click(lambda _: self.toggle())

    def show(self) -> None:
        """Draw the moment at the slider's time: the last one until then."""
        k = int(np.searchsorted(self.times, self._slider.value + 0.5 * STEP, side='right')) - 1
        self._draw(self._run[max(k, 0)])

    def toggle(self) -> None:
        """Play, or pause."""
        if self._ticker.running:
            self.pause()
            return
        if self._slider.value >= self._end - STEP:
            self._slider.value = self._start
        self._button.label = 'Pause'
        self._ticker.start()

    def pause(self) -> None:
        """Stop where it is."""
        self._ticker.stop()
        self._button.label = 'Play'

    def close(self) -> None:
        """Stop, and take the folder away."""
        self._ticker.stop()
        self._folder.remove()

    def _tick(self, passed: float) -> None:
        if not self._watched():
            return
        t = self._slider.value + passed * float(self._speed.value)
        if t < self._end:
            self._slider.value = t
        elif self._again.value:
            self._slider.value = self._start
        else:
            self._slider.value = self._end
            self.pause()


class Ticker:
    """Calls back at a period, less often when a call takes longer than that.

    Parameters
    ----------
    tick : callable
        Takes the time since the last call [s].
    """

    def __init__(self, period: float, tick: Callable[[float], None]) -> None:
        self._period, self._tick = period, tick
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None
        self._guard = threading.Lock()

    @property
    def running(self) -> bool:
        """Whether it ticks."""
        return self._thread is not None and not self._stopped.is_set()

    def start(self) -> None:
        """Start ticking; nothing if it does already."""
        with self._guard:
            if not self.running:
                self._stopped = threading.Event()
                arguments = (self._stopped,)
                self._thread = threading.Thread(target=self._run, args=arguments, daemon=True)
                self._thread.start()

    def stop(self) -> None:
        """Stop ticking; a call under way is not waited for."""
        self._stopped.set()

    def _run(self, stopped: threading.Event) -> None:
        last = time.monotonic()
        while not stopped.wait(max(0.0, last + self._period - time.monotonic())):
            now = time.monotonic()
            self._tick(now - last)
            last = now
