"""Figures of a run as inline SVG: small multiples, units on every axis, one legend each."""

from __future__ import annotations

import io
import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from denoc_ros.cli.measures import LoopMeasure

Array = NDArray[np.float64]

# Colour-blind safe; a phase keeps its colour in every figure.
PHASE_COLOURS = ('#d1622b', '#1f6fb2', '#2e8b57', '#8e5ea2')
TRUTH_COLOUR = '#20242a'
DIFFERENCE_COLOUR = '#9ca3af'
MUTED = '#6b7280'
PIXELS = 900  # columns a curve is thinned to: finer than a page shows
WIDTH = 9.6  # inches of a full-width figure
LAST_PERIOD = 2.0  # nominal periods a histogram shows
SCALES = ((1.0, ''), (1e-3, 'm'), (1e-6, 'µ'))
STYLE = {
    'font.family': 'sans-serif',
    'font.size': 9.0,
    'svg.fonttype': 'none',
    'path.simplify': True,
}


@dataclass(frozen=True)
class Curve:
    """One line of a panel."""

    label: str
    colour: str
    t: Array  # (k,) s, or what the panel's x label says
    y: Array  # (k,) in the panel's unit
    dashed: bool = False
    marker: str = ''  # drawn instead of a line
    error: Array | None = None  # (k,) half a bar about each value


@dataclass(frozen=True)
class Panel:
    """One axes of a figure."""

    title: str
    unit: str  # SI, scaled by a prefix where the values are small
    curves: Sequence[Curve]
    x_label: str = 'time [s]'
    log_x: bool = False
    log_y: bool = False


def line_figure(panels: Sequence[Panel], height: float = 1.9) -> str:
    """Return panels, over time if they say nothing else, as one SVG in one or two columns.

    Parameters
    ----------
    panels : sequence of Panel
        In reading order.
    height : float
        Of a row [inch].
    """
    columns = 1 if len(panels) == 1 else 2
    rows = math.ceil(len(panels) / columns)
    figure = Figure(figsize=(WIDTH, height * rows + 0.75), layout='constrained')
    axes = figure.subplots(rows, columns, squeeze=False)
    for axis, panel in zip(axes.flat, panels, strict=False):
        _draw_lines(axis, panel)
    for axis in axes.flat[len(panels) :]:
        axis.set_axis_off()
    for k, panel in enumerate(panels):
        below = panels[k + columns] if k + columns < len(panels) else None
        if below is None or below.x_label != panel.x_label:
            axes.flat[k].set_xlabel(panel.x_label)
    _shared_legend(figure, list(axes.flat[: len(panels)]))
    return _svg(figure)


def histogram_figure(loops: Sequence[LoopMeasure]) -> str:
    """Return a histogram of loop periods per node, counts on a logarithmic axis."""
    columns = min(3, len(loops))
    rows = math.ceil(len(loops) / columns)
    figure = Figure(figsize=(WIDTH, 2.3 * rows + 0.35), layout='constrained')
    axes = figure.subplots(rows, columns, squeeze=False)
    for axis, loop in zip(axes.flat, loops, strict=False):
        _draw_histogram(axis, loop)
    for axis in axes.flat[len(loops) :]:
        axis.set_axis_off()
    return _svg(figure)


def thin(t: Array, y: Array, columns: int = PIXELS) -> tuple[Array, Array]:
    """Return a curve with at most two points per column, its extremes kept.

    Parameters
    ----------
    t, y : (k,) array
        The curve.
    columns : int
        How many equal stretches of it keep their smallest and largest value.
    """
    size = len(y)
    if size <= 2 * columns:
        return t, y
    edges = np.linspace(0, size, columns + 1).astype(np.intp)
    keep = {0, size - 1}
    for low, high in itertools.pairwise(edges):
        stretch = y[low:high]
        if np.isfinite(stretch).any():
            keep.update((int(low + np.nanargmin(stretch)), int(low + np.nanargmax(stretch))))
    index = np.array(sorted(keep), dtype=np.intp)
    return t[index], y[index]


def scale_of(values: Sequence[Array]) -> tuple[float, str]:
    """Return the SI prefix (factor and letter) that brings the largest value above 1."""
    peak = max((float(np.nanmax(np.abs(v))) for v in values if np.isfinite(v).any()), default=0.0)
    if peak == 0.0:
        return SCALES[0]
    return next((entry for entry in SCALES if peak >= entry[0]), SCALES[-1])


def _draw_lines(axis: Axes, panel: Panel) -> None:
    factor, prefix = scale_of([curve.y for curve in panel.curves]) if panel.unit else SCALES[0]
    for curve in panel.curves:
        t, y = (curve.t, curve.y) if curve.marker else thin(curve.t, curve.y)
        style = (0, (4, 2)) if curve.dashed else 'solid'
        look = {'ls': 'none', 'marker': curve.marker, 'ms': 4.0} if curve.marker else {'ls': style}
        if curve.error is not None:
            bars = curve.error / factor
            axis.errorbar(
                t, y / factor, bars, color=curve.colour, lw=1.1, label=curve.label, **look
            )
        else:
            axis.plot(t, y / factor, color=curve.colour, lw=1.1, label=curve.label, **look)
    if panel.log_x:
        axis.set_xscale('log')
    if panel.log_y:
        axis.set_yscale('log')
    axis.set_title(panel.title, loc='left', fontsize=9.5, color=TRUTH_COLOUR)
    axis.set_ylabel(f'[{prefix}{panel.unit}]' if panel.unit else '')
    _tidy(axis)


def _draw_histogram(axis: Axes, loop: LoopMeasure) -> None:
    """Draw the bars up to LAST_PERIOD nominal periods; what is beyond is said in words."""
    edges = loop.edges * loop.nominal * 1e3
    shown = int(np.searchsorted(loop.edges, LAST_PERIOD, side='right')) - 1
    counts = loop.counts[:shown]
    beyond = int(loop.counts.sum() - counts.sum())
    axis.stairs(counts, edges[: shown + 1], fill=True, color='#7aa6c9')
    axis.axvline(1e3 * loop.nominal, color=PHASE_COLOURS[0], lw=0.9)
    axis.set_yscale('log')
    axis.set_ylim(bottom=0.7)
    axis.set_xlim(0.0, LAST_PERIOD * loop.nominal * 1e3)
    axis.set_title(f'{loop.node}, {1.0 / loop.nominal:g} Hz', loc='left', fontsize=9.5)
    label = 'period [ms]'
    if beyond:
        label += f'   (longer: {beyond}, max {1e3 * loop.longest:.3g} ms)'
    axis.set_xlabel(label, fontsize=8.5)
    axis.set_ylabel('ticks')
    _tidy(axis)


def _tidy(axis: Axes) -> None:
    axis.grid(True, color='#e5e7eb', lw=0.6)
    axis.set_axisbelow(True)
    for side in ('top', 'right'):
        axis.spines[side].set_visible(False)
    for side in ('left', 'bottom'):
        axis.spines[side].set_color('#9ca3af')
    axis.tick_params(colors=MUTED, labelsize=8)
    axis.margins(x=0.01)


def _shared_legend(figure: Figure, axes: Sequence[Axes]) -> None:
    """Put one legend on top for all panels instead of one over the data of each."""
    entries: dict[str, Artist] = {}
    for axis in axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    if len(entries) > 1:
        figure.legend(
            list(entries.values()),
            list(entries),
            loc='outside upper left',
            ncols=len(entries),
            frameon=False,
        )


def _svg(figure: Figure) -> str:
    """Return the figure as an `<svg>` element that scales with the page."""
    from matplotlib import rc_context

    text = io.StringIO()
    with rc_context(STYLE):
        figure.savefig(text, format='svg', metadata={'Date': None})
    svg = text.getvalue()
    svg = svg[svg.index('<svg') :]
    svg = re.sub(r'<metadata>.*?</metadata>', '', svg, flags=re.DOTALL)
    svg = re.sub(r' d="[^"]*"', lambda path: re.sub(r'(\.\d{2})\d+', r'\1', path[0]), svg)
    return re.sub(r'width="[\d.]+pt" height="[\d.]+pt"', 'class="figure"', svg, count=1)
