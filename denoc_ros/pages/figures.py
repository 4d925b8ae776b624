"""Figures of a page as inline SVG: small panels, units on every axis, colours by CSS variables."""

from __future__ import annotations

import io
import itertools
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape

import numpy as np
from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_svg import FigureCanvasSVG, RendererSVG
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import LogFormatterSciNotation, LogLocator
from matplotlib.transforms import Bbox

from denoc_ros.pages.loop_timing import LoopMeasure
from denoc_ros.terminal_text import visible
from denoc_ros.types import Array
from denoc_ros.units import NONE, si_prefix


class Ink:
    """Colours by the page's CSS variables: a phase keeps its own in every figure and theme."""

    PHASES = ('series-1', 'series-2', 'series-3', 'series-4', 'series-5', 'series-6')
    TRUTH = 'ink'
    DIFFERENCE = 'difference'
    BARS = 'bars'
    GRID = 'line'
    AXIS = 'muted'


COLOURS = (*Ink.PHASES, Ink.TRUTH, Ink.DIFFERENCE, Ink.BARS, Ink.GRID, Ink.AXIS)
PIXELS = 900  # columns a curve is thinned to: finer than a page shows
WIDTH, LONE_WIDTH = 4.4, 4.8  # inches of a panel: text of 10 points is read on a phone too
HISTOGRAM_HEIGHT = 2.0  # inches
RESULT_HEIGHT = 2.3  # inches, of a panel on the pages of results
POINTS = 72.0  # per inch
PAD = 3.0  # points around all that a panel shows
MARGINS = (46.0, 33.0, 6.0, 4.0)  # points left, below, right and above the axes, about
LAST_PERIOD = 2.0  # nominal periods a histogram shows
OVERFLOW_ROOM = 0.12  # of those, for the bar of all that are longer
OVERFLOW = 'overflow'  # class of that bar
SMALLEST = 1e-6  # prefix on an axis
MOST_FITS = 3
CLOSE = 0.8  # decades: a shorter logarithmic axis has marks of every digit
LABELLED = (1.5, 0.3)  # decades up to which marks, and marks of every digit, have labels
STYLE = {
    'font.family': 'sans-serif',
    'font.size': 10.0,
    'svg.fonttype': 'none',
    'path.simplify': True,
}
SUPERSCRIPTS = str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹')
Margins = tuple[float, float, float, float]
AXIS_LABEL = 'axis-label'  # class of the groups that hold an axis' label


@dataclass(frozen=True)
class Curve:
    """One line of a panel."""

    label: str
    colour: str  # one of COLOURS
    t: Array  # (k,) s, or what the panel's x label says
    y: Array  # (k,) in the panel's unit
    dashed: bool = False
    marker: str = ''  # drawn instead of a line
    error: Array | None = None  # (k,) half a bar about each value


@dataclass(frozen=True)
class Panel:
    """One axes of a figure."""

    title: str
    unit: str  # SI, scaled by a prefix where the values are small; '': a plain number
    curves: Sequence[Curve]
    x_label: str = 'time [s]'
    log_x: bool = False
    log_y: bool = False


@dataclass(frozen=True)
class Drawing:
    """A panel as the page shows it: its caption, and an `<svg>` element."""

    title: str
    svg: Markup


class PlainPowers(LogFormatterSciNotation):
    """Powers of ten as plain text: laid out in a fraction of the time that TeX takes."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """Return the label of a tick, '' of one that has none."""
        label = str(super().__call__(x, pos))
        label = label.replace('$', '').replace(r'\mathdefault{', '').replace(r'\times', '×')
        label = re.sub(r'\^\{(-?\d+)\}', lambda power: power[1].translate(SUPERSCRIPTS), label)
        return label.replace('}', '').replace('-', '−')


@dataclass(frozen=True)
class Figure:
    """Panels that share a legend; one label alone needs none."""

    drawings: Sequence[Drawing]
    legend: Sequence[Curve] = ()


def line_figure(panels: Sequence[Panel], height: float = 1.9) -> Figure:
    """Return panels, over time if they say nothing else, as a figure.

    Parameters
    ----------
    height : float
        Of a panel [inch].
    """
    width = LONE_WIDTH if len(panels) == 1 else WIDTH
    drawings = [
        Drawing(panel.title, _svg(partial(_draw_lines, panel=panel), width, height))
        for panel in panels
    ]
    entries: dict[str, Curve] = {}
    for curve in itertools.chain.from_iterable(panel.curves for panel in panels):
        if curve.label:
            entries.setdefault(curve.label, curve)
    return Figure(drawings, list(entries.values()) if len(entries) > 1 else ())


def histogram_figure(loops: Sequence[LoopMeasure]) -> Figure:
    """Return a histogram of loop periods per node, counts on a logarithmic axis."""
    width = LONE_WIDTH if len(loops) == 1 else WIDTH
    return Figure(
        [
            Drawing(
                f'{loop.node}, {1.0 / loop.nominal:g} Hz',
                _svg(partial(_draw_histogram, loop=loop), width, HISTOGRAM_HEIGHT),
            )
            for loop in loops
        ]
    )


def thin(t: Array, y: Array, columns: int = PIXELS) -> tuple[Array, Array]:
    """Return a curve with at most two points per column, its extremes kept.

    Parameters
    ----------
    columns : int
        How many equal stretches of it keep their smallest and largest value.
    """
    size = len(y)
    if size <= 2 * columns:
        return t, y
    width = -(-size // columns)
    stretches = np.full((columns, width), np.nan)
    stretches.flat[:size] = y
    some = np.flatnonzero(np.isfinite(stretches).any(axis=1))
    extremes = [
        some * width + pick(stretches[some], axis=1) for pick in (np.nanargmin, np.nanargmax)
    ]
    index = np.unique(np.concatenate([[0, size - 1], *extremes]))
    return t[index], y[index]


def scale_of(values: Iterable[Array]) -> tuple[float, str]:
    """Return the SI prefix (factor and letter) that brings the largest value close above 1."""
    peak = max((float(np.nanmax(np.abs(v))) for v in values if np.isfinite(v).any()), default=0.0)
    return si_prefix(peak, SMALLEST)


def _draw_lines(axis: Axes, panel: Panel) -> str:
    """Draw a panel; return a description in words."""
    # a logarithmic axis has its powers of ten, a plain number or a percentage takes no prefix
    plain = panel.log_y or not panel.unit or panel.unit.startswith('%')
    factor, prefix = NONE if plain else scale_of(curve.y for curve in panel.curves)
    for curve in panel.curves:
        t, y = (curve.t, curve.y) if curve.marker else thin(curve.t, curve.y)
        style = (0, (4, 2)) if curve.dashed else 'solid'
        look = {'ls': 'none', 'marker': curve.marker, 'ms': 4.0} if curve.marker else {'ls': style}
        colour = _stand_in(curve.colour)
        if curve.error is None:
            axis.plot(t, y / factor, color=colour, lw=1.2, **look)
        else:
            axis.errorbar(t, y / factor, curve.error / factor, color=colour, lw=1.2, **look)
    if panel.log_x:
        axis.set_xscale('log')
        _label_powers(axis.xaxis)
    if panel.log_y:
        axis.set_yscale('log')
        _label_powers(axis.yaxis)
    # Units of foreign files are no formulas: a dollar sign in them may not parse.
    label = f'[{prefix}{panel.unit or 1}]'
    axis.set_xlabel(visible(panel.x_label), parse_math=False)
    axis.set_ylabel(visible(label), parse_math=False)
    _tidy(axis)
    return _described(panel, label)


def _draw_histogram(axis: Axes, loop: LoopMeasure) -> str:
    """Draw the bars up to LAST_PERIOD nominal periods, and one for all that are longer."""
    edges = loop.edges * loop.nominal * 1e3
    shown = int(np.searchsorted(loop.edges, LAST_PERIOD, side='right')) - 1
    counts = loop.counts[:shown]
    beyond = int(loop.counts.sum() - counts.sum())
    axis.stairs(counts, edges[: shown + 1], fill=True, color=_stand_in(Ink.BARS))
    axis.axvline(1e3 * loop.nominal, color=_stand_in(Ink.PHASES[0]), lw=0.9)
    axis.set_yscale('log')
    axis.set_ylim(0.7, 3.0 * max(float(counts.max(initial=1.0)), float(beyond), 1.0))
    _label_powers(axis.yaxis)
    last = LAST_PERIOD * loop.nominal * 1e3
    axis.set_xlim(0.0, last * (1.0 + OVERFLOW_ROOM))
    label = 'period [ms]'
    if beyond:
        middle = last * (1.0 + 0.5 * OVERFLOW_ROOM)
        (bar,) = axis.bar(
            middle, beyond, 0.6 * OVERFLOW_ROOM * last, color=_stand_in(Ink.PHASES[4])
        )
        bar.set_gid(OVERFLOW)
        axis.annotate(
            f'{beyond} longer', (middle, beyond), (0.0, 3.0), textcoords='offset points',
            ha='right', fontsize=9, color=_stand_in(Ink.TRUTH),
        )  # fmt: skip
        label += f'   (the last bar: longer, max {1e3 * loop.longest:.3g} ms)'
    axis.set_xlabel(label)
    axis.set_ylabel('ticks [1]')
    _tidy(axis)
    return f'Histogram of {loop.ticks} periods of {loop.node} [ms]'


def _label_powers(side: Axis) -> None:
    low, high = side.get_view_interval()
    side.set_major_formatter(PlainPowers())
    side.set_minor_formatter(PlainPowers(labelOnlyBase=False, minor_thresholds=LABELLED))
    if high > 10.0**CLOSE * low:  # marks of every digit would take most of the time of drawing
        side.set_minor_locator(LogLocator(subs=(2.0, 5.0)))


def _tidy(axis: Axes) -> None:
    axis.set_facecolor('none')
    axis.grid(True, color=_stand_in(Ink.GRID), lw=0.7)
    axis.set_axisbelow(True)
    for side in ('top', 'right'):
        axis.spines[side].set_visible(False)
    muted = _stand_in(Ink.AXIS)
    for side in ('left', 'bottom'):
        axis.spines[side].set_color(muted)
    axis.tick_params(which='both', colors=muted, labelsize=9)
    for one in (axis.xaxis, axis.yaxis):
        one.label.set_color(_stand_in(Ink.TRUTH))
        one.label.set_gid(AXIS_LABEL)
        one.offsetText.set_color(muted)
    axis.margins(x=0.01)


def _described(panel: Panel, y_label: str) -> str:
    """Describe a panel in words, for readers who do not see it."""
    values = [curve.y[np.isfinite(curve.y)] for curve in panel.curves]
    values = [one for one in values if len(one)]
    extent = ''
    if values:
        low, high = min(map(np.min, values)), max(map(np.max, values))
        extent = f', from {low:.3g} to {high:.3g} {panel.unit}'.rstrip()
    named = ', '.join(dict.fromkeys(curve.label for curve in panel.curves if curve.label))
    return f'{panel.title} {y_label} over {panel.x_label}{extent}' + (f': {named}' * bool(named))


def _stand_in(colour: str) -> str:
    """Return the colour that is drawn in place of a CSS variable, which matplotlib cannot have."""
    return f'#0102{COLOURS.index(colour):02x}'


def _fit(axis: Axes, width: float, height: float) -> None:
    """Give the labels of a panel of that size [inch] the room that they take.

    matplotlib's constrained layout does the same for any arrangement, in twice the time that
    drawing takes.
    """
    renderer = RendererSVG(POINTS * width, POINTS * height, io.StringIO())
    sides = (axis.xaxis, axis.yaxis)
    for _ in range(MOST_FITS):
        space = [side.get_tick_space() for side in sides]
        extents = [side.get_tightbbox(renderer, for_layout_only=True) for side in sides]
        whole, box = Bbox.union([one for one in extents if one is not None]), axis.bbox
        margins = (box.x0 - whole.x0, box.y0 - whole.y0, whole.x1 - box.x1, whole.y1 - box.y1)
        left, low, right, top = (PAD + max(margin, 0.0) for margin in margins)
        axis.set_position(_inside((left, low, right, top), width, height))
        if [side.get_tick_space() for side in sides] == space:  # the ticks, then, stay
            return


def _inside(margins: Margins, width: float, height: float) -> Margins:
    """Return left, bottom, width and height in parts of the panel's, within margins [points]."""
    left, low, right, top = margins
    across, up = POINTS * width, POINTS * height
    return left / across, low / up, (across - left - right) / across, (up - low - top) / up


def _svg(draw: Callable[[Axes], str], width: float, height: float) -> Markup:
    """Draw a figure as an `<svg>` element with a description; it scales with the page."""
    text = io.StringIO()
    with rc_context(STYLE):
        canvas = Canvas(figsize=(width, height), dpi=POINTS, facecolor='none')
        axis = canvas.add_axes(_inside(MARGINS, width, height))
        label = draw(axis)
        _fit(axis, width, height)
        FigureCanvasSVG(canvas).print_svg(text, metadata={'Date': None})
    svg = text.getvalue()
    svg = svg[svg.index('<svg') :]
    svg = re.sub(r'<metadata>.*?</metadata>', '', svg, flags=re.DOTALL)
    svg = re.sub(r' d="[^"]*"', lambda path: re.sub(r'(\.\d{2})\d+', r'\1', path[0]), svg)
    for colour in COLOURS:
        svg = svg.replace(_stand_in(colour), f'var(--{colour})')
    for name in (AXIS_LABEL, OVERFLOW):
        svg = svg.replace(f'id="{name}"', f'class="{name}"')
    # what nothing refers to need not have a name, which would not be the only one on the page
    svg = re.sub(r' id="[A-Za-z0-9.]+_\d+"', '', svg)
    described = f'role="img" aria-label="{escape(visible(label))}"'
    return Markup(re.sub(r'width="[\d.]+pt" height="[\d.]+pt"', lambda _: described, svg, count=1))
