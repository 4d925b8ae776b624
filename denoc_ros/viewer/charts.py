"""Strip charts: the channels of moments over time, one chart per group."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from denoc_ros.types import Array

WINDOW = 20.0  # s that live charts show
PERIOD = 0.2  # s between two drawings of live charts
MOST_POINTS = 1200  # of a curve
MOST_CURVES = 8  # of a chart: more cannot be told apart
HEIGHT = 170  # pixels
LABELS = 62  # pixels left of a chart
MARGIN = 0.08  # of a chart's height
LEAST_FILLED = 0.4  # of it
PALETTE = (
    '#2166be', '#c82828', '#168c5a', '#8c46be', '#d97706', '#0e7490', '#64748b', '#be185d'
)  # fmt: skip
NOW = '#111827'


def grouped(names: Sequence[str]) -> dict[str, list[str]]:
    """Return the channels of each group, `group/name`, those that a chart has room for."""
    groups: dict[str, list[str]] = {}
    for name in names:
        group, slash, _ = name.partition('/')
        groups.setdefault(group if slash else '', []).append(name)
    return {group: members[:MOST_CURVES] for group, members in groups.items()}


class Charts:
    """The charts of a page."""

    def __init__(self, gui: Any) -> None:
        self._gui = gui
        self._folder: Any = None
        self._charts: dict[str, Any] = {}
        self._groups: dict[str, list[str]] = {}
        self._ranges: dict[str, tuple[float, float]] = {}
        self._names: list[str] = []
        self._t: list[float] = []
        self._rows: list[list[float]] = []
        self._drawn = -np.inf
        self._recorded: tuple[Array, Array] | None = None

    def add(self, t: float, channels: Mapping[str, float]) -> None:
        """Add an instant of a live session."""
        if self._recorded is not None or not channels:
            return
        if set(channels) - set(self._names) or (self._t and t < self._t[-1]):
            self._restart([*self._names, *(n for n in channels if n not in self._names)])
        self._t.append(t)
        self._rows.append([channels.get(name, np.nan) for name in self._names])
        gone = int(np.searchsorted(self._t, t - WINDOW))
        if gone > len(self._t) // 4:
            del self._t[:gone], self._rows[:gone]

    def draw(self) -> None:
        """Draw the live curves, not more often than they can be looked at."""
        now = time.monotonic()
        if self._recorded is None and len(self._t) > 1 and now - self._drawn >= PERIOD:
            self._drawn = now
            step = -(-len(self._t) // MOST_POINTS)
            t, rows = np.array(self._t[::step]), np.array(self._rows[::step])
            self._put(t, rows, None)

    def record(self, t: Array, names: Sequence[str], values: Array) -> None:
        """Show the whole of a recorded run: times (k,) and values (k, names)."""
        self._restart(list(names))
        step = -(-len(t) // MOST_POINTS)
        self._recorded = t[::step], values[::step]
        if names and len(t) > 1:
            self._put(*self._recorded, float(t[0]))

    def point(self, t: float) -> None:
        """Mark an instant of the recorded run, not more often than can be looked at."""
        now = time.monotonic()
        if self._recorded is not None and self._names and now - self._drawn >= PERIOD:
            self._drawn = now
            self._put(*self._recorded, t)

    def clear(self) -> None:
        """Take all charts away."""
        self._restart([])
        self._recorded = None

    def _restart(self, names: list[str]) -> None:
        self._names, self._t, self._rows = names, [], []
        if self._folder is not None:
            self._folder.remove()
            self._folder = None
        self._charts, self._ranges, self._groups = {}, {}, grouped(names)

    def _put(self, t: Array, rows: Array, now: float | None) -> None:
        if self._folder is None:
            self._folder = self._gui.add_folder('Charts', order=90.0)
        for group, members in self._groups.items():
            columns = [rows[:, self._names.index(name)] for name in members]
            low, high = _range(columns, self._ranges.get(group))
            data = (t, *columns, _mark(t, low, high, now))
            # what is no number would spoil a range that the chart finds by itself
            scales = {'x': {'time': False}, 'y': {'range': (low, high)}}
            chart = self._charts.get(group)
            if chart is None:
                with self._folder:
                    self._charts[group] = self._chart(group, members, data, scales)
            else:
                if (low, high) != self._ranges[group]:
                    chart.scales = scales
                chart.data = data
            self._ranges[group] = low, high

    def _chart(
        self,
        group: str,
        members: Sequence[str],
        data: tuple[Array, ...],
        scales: Mapping[str, Any],
    ) -> Any:
        series = [{'label': 't [s]'}]
        for name, colour in zip(members, PALETTE, strict=False):
            label = name.partition('/')[2] or name
            series.append({'label': label, 'stroke': colour, 'width': 1.5})  # type: ignore[dict-item]
        series.append({'label': 'now', 'stroke': NOW, 'width': 1})  # type: ignore[dict-item]
        return self._gui.add_uplot(
            data=data,
            series=tuple(series),
            title=group,
            scales=scales,
            axes=({}, {'size': LABELS}),
            height=HEIGHT,
        )


def _range(columns: Sequence[Array], before: tuple[float, float] | None) -> tuple[float, float]:
    """Return an axis for curves, the one before while it does."""
    values = np.concatenate(columns)
    values = values[np.isfinite(values)]
    low, high = (values.min(), values.max()) if len(values) else (0.0, 0.0)
    if before is not None:
        held = before[0] <= low and high <= before[1]
        if held and high - low >= LEAST_FILLED * (before[1] - before[0]):
            return before
    margin = MARGIN * (high - low) or MARGIN * abs(high) or 1.0
    return float(low - margin), float(high + margin)


def _mark(t: Array, low: float, high: float, now: float | None) -> Array:
    """Return a curve that is an upright line at an instant."""
    line = np.full(len(t), np.nan)
    if now is not None and len(t) > 1:
        k = int(np.clip(np.searchsorted(t, now) - 1, 0, len(t) - 2))
        line[k : k + 2] = low, high
    return line
