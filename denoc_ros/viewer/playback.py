"""Play, pause and scrub a recorded run on a page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from denoc_ros.viewer.snapshot import Snapshot
from denoc_ros.viewer.ticker import Ticker

PERIOD = 1.0 / 30.0  # s between two pictures
SPEEDS = ('0.1', '0.25', '0.5', '1', '2', '5')
STEP = 1e-3  # s, of the slider


class Playback:
    """The folder of a page that goes through a run.

    Parameters
    ----------
    gui : viser's gui
    run : sequence of Snapshot
        At least one, in order of time.
    draw : callable
        Draws a moment.
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
