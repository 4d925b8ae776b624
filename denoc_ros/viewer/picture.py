"""One picture of a run: the robot in its surroundings, strain's colour bar, strip charts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator, MultipleLocator
from numpy.typing import NDArray

from denoc_ros.simulation.recorded.run_snapshots import RecordedRun
from denoc_ros.terminal_text import visible
from denoc_ros.types import Array
from denoc_ros.units import round_up, si_prefix
from denoc_ros.viewer.bending import strain_colours
from denoc_ros.viewer.scene_setup import SceneSetup

Pixels = NDArray[np.uint8]

PAPER, GHOST = '#ffffff', '#d3d8df'
HEADER, FOOTER, GAP, LEAST_STRIP = 52, 46, 24, 240  # pixels, of a strip
HEADER_SIDE = 0.02  # Margin beside a header, as a share of the width.
LONGEST_TIME = 999.99  # The header of a film has room for this time [s].
LEAST = (600, 340)  # pixels; a smaller picture has no charts
MARGIN = 0.06  # of the field of view
SQUARES = 10  # of a grid along its longer side, at most
BEHIND = 0.5  # drawn before the robot
TRAIL = 0.7  # drawn before the robot, over the floor
INK, MUTED, GRID = '#20242a', '#6b7280', '#e5e7eb'
CURVES = ('#d1622b', '#1f6fb2', '#2e8b57', '#8e5ea2', '#b8860b', '#4b5563')
MOST_CURVES = 6  # of a chart; the largest are shown
MOST_CHARTS = 3
LEGEND_COLUMNS = 2  # Two names of curves are at most as wide as a chart.
LEGEND_ROW = 0.25  # Height of a row of a legend, as a share of the height of the curves.
SMALLEST = 1e-6  # prefix on an axis


class Scene:
    """Axes that show the robot in front of its surroundings.

    Parameters
    ----------
    noted : bool
        Whether the size of the floor's squares stands below other views.
    """

    def __init__(
        self, axes: Axes, staging: SceneSetup, numbered: bool = True, noted: bool = True
    ) -> None:
        self._staging = staging
        self.axes = axes
        axes.set_facecolor(PAPER)
        _fit(axes, staging)
        if staging.camera.flat:
            _coordinates(axes, staging, numbered)
        else:
            _floor(axes, staging, noted)
        self.ghost = PolyCollection([], facecolors=GHOST, edgecolors=GHOST, linewidths=0.8)
        self.robot = PolyCollection([], linewidths=0.3)
        for collection in (self.ghost, self.robot):
            axes.add_collection(collection, autolim=False)

    def show(self, q: Array) -> None:
        """Put the robot where coordinates (n,) say."""
        self.ghost.set_verts(list(self._staging.ghost(q)))
        drawn = self._staging.robot(q)
        self.robot.set_verts(list(drawn.corners))
        self.robot.set_facecolor(drawn.colours)
        self.robot.set_edgecolor(drawn.colours)


class Canvas:
    """A figure whose still part is drawn once, and whose moving artists are drawn over a copy."""

    def __init__(self, size: tuple[int, int]) -> None:
        self.figure, self._canvas = _figure(size)
        self._moving: list[Any] = []

    def animate(self, moving: list[Any]) -> None:
        """Draw all but these artists."""
        self._moving = moving
        for artist in moving:
            artist.set_animated(True)
        _draw(self._canvas)
        self._still = self._canvas.copy_from_bbox(self.figure.bbox)

    def pixels(self) -> Pixels:
        """Return the frame (height, width, 3) with the moving artists as they are."""
        self._canvas.restore_region(self._still)
        for artist in self._moving:
            self.figure.draw_artist(artist)
        return np.array(self._canvas.buffer_rgba())[:, :, :3]


class ComparisonPicture:
    """Frames of a film that shows several motions of a robot beside each other.

    Parameters
    ----------
    size : (int, int)
        Width and height [pixels].
    """

    def __init__(
        self,
        staging: SceneSetup,
        names: Sequence[str],
        title: str,
        stated: str,
        size: tuple[int, int],
    ) -> None:
        self._staging = staging
        self._canvas = Canvas(size)
        figure = self._canvas.figure
        grid = figure.add_gridspec(
            1, len(names), left=0.05, right=0.985, bottom=0.07, top=0.87, wspace=0.04
        )
        self._scenes = []
        for k, name in enumerate(names):
            axes = figure.add_subplot(grid[0, k])
            self._scenes.append(Scene(axes, staging, k == 0, k == 0))
            axes.set_title(name, loc='left', size=10, color=INK, pad=3)
        self._trails = [
            scene.axes.plot([], [], color=CURVES[1], lw=1.2, zorder=TRAIL)[0]
            for scene in self._scenes
        ]
        self._time = draw_header(
            figure, 0.95, title, f'{stated}, blue: path of the tip', _when('')
        )
        self._paths: list[list[Array]] = [[] for _ in names]
        bodies = [each for scene in self._scenes for each in (scene.ghost, scene.robot)]
        self._canvas.animate([*self._trails, *bodies, self._time])

    def draw(self, t: float, states: Sequence[Array]) -> Pixels:
        """Return the next frame (height, width, 3).

        Parameters
        ----------
        t : float
            Since the motions began [s]; 0 begins the paths of the tips anew.
        states : sequence of (n,) arrays
            Coordinates in each motion.
        """
        for scene, trail, path, q in zip(
            self._scenes, self._trails, self._paths, states, strict=True
        ):
            scene.show(q)
            if t == 0.0:
                path.clear()
            path.append(self._staging.tip(q))
            trail.set_data(*np.transpose(path))
        self._time.set_text(_when('', t))
        return self._canvas.pixels()


class Picture:
    """Frames of a film: static parts are drawn once, moving parts into a copy.

    Parameters
    ----------
    size : (int, int)
        Width and height [pixels].
    """

    def __init__(
        self, run: RecordedRun, staging: SceneSetup, title: str, size: tuple[int, int]
    ) -> None:
        self._run = run
        self._canvas = Canvas(size)
        figure = self._canvas.figure
        groups = chart_groups(run) if size[0] >= LEAST[0] and size[1] >= LEAST[1] else {}
        bottom = 0.3 if groups else 0.07
        bar = 0.08 if staging.strain > 0.0 else 0.0
        scene = figure.add_axes((0.05, bottom, 0.93 - bar, 0.93 - bottom))
        self._scene = Scene(scene, staging)
        if bar:
            low = bottom + 0.06
            _colour_bar(figure, (0.93, low, 0.012, 0.76 - bottom), staging)
        self._cursors = draw_charts(figure, run, groups)
        longest = max((name for _, name in run.phases), key=len, default='')
        self._time = draw_header(figure, 0.965, title, stated(run, staging), _when(longest))
        bodies = self._scene.ghost, self._scene.robot
        self._canvas.animate([*bodies, self._time, *self._cursors])

    def draw(self, t: float, q: Array) -> Pixels:
        """Return the frame (height, width, 3) at a time [s] with coordinates (n,)."""
        self._scene.show(q)
        self._time.set_text(_when(self._run.phase(t), t))
        for cursor in self._cursors:
            cursor.set_xdata([t, t])
        return self._canvas.pixels()


def strip(
    run: RecordedRun, staging: SceneSetup, title: str, size: tuple[int, int], times: Array
) -> Pixels:
    """Return several instants of a run side by side, (height, width, 3).

    Parameters
    ----------
    times : (k,) array
        Of the instants [s].
    """
    rows, columns = _arrangement(staging, size, len(times))
    right = 0.91 if staging.strain > 0.0 else 0.98
    low, high = field_of_view(staging)
    panel = (right - 0.05) * size[0] / columns
    around = HEADER + FOOTER + rows * GAP
    needed = rows * panel * (high - low)[1] / (high - low)[0] + around
    height = 2 * round(min(float(size[1]), max(needed, LEAST_STRIP)) / 2)
    panel_height = (height - around) / rows
    figure, canvas = _figure((size[0], height))
    top, bottom = 1.0 - (HEADER + GAP) / height, FOOTER / height
    grid = figure.add_gridspec(
        rows,
        columns,
        left=0.05,
        right=right,
        bottom=bottom,
        top=top,
        wspace=0.03,
        hspace=GAP / panel_height,
    )
    states = run.at(times)
    for k, (t, q) in enumerate(zip(times, states, strict=True)):
        axes = figure.add_subplot(grid[k // columns, k % columns])
        Scene(axes, staging, k == (rows - 1) * columns, k == 0).show(q)
        axes.set_title(_when(run.phase(float(t)), float(t)), loc='left', size=10, color=INK, pad=3)
    if staging.strain > 0.0:
        _colour_bar(figure, (0.93, bottom, 0.012, top - bottom - 0.13), staging)
    draw_header(figure, 1.0 - 0.5 * HEADER / height, title, stated(run, staging))
    _draw(canvas)
    return np.array(canvas.buffer_rgba())[:, :, :3]


def _arrangement(staging: SceneSetup, size: tuple[int, int], count: int) -> tuple[int, int]:
    """Return the rows and columns of panels in which the robot is drawn largest."""
    low, high = field_of_view(staging)
    wide, tall = high - low

    def zoom(columns: int) -> float:
        return float(min(size[0] / columns / wide, size[1] / -(-count // columns) / tall))

    columns = max(range(1, count + 1), key=zoom)
    return -(-count // columns), columns


def _figure(size: tuple[int, int]) -> tuple[Figure, FigureCanvasAgg]:
    # text keeps its share of the picture, but for small ones, where it would be too small
    dpi = max(62.0, size[0] / 10.24)
    figure = Figure(figsize=(size[0] / dpi, size[1] / dpi), dpi=dpi, facecolor=PAPER)
    return figure, FigureCanvasAgg(figure)


def _draw(canvas: FigureCanvasAgg) -> None:
    """Draw a figure; dollar signs in names of files are no formulas, which might not parse."""
    for text in canvas.figure.findobj(Text):
        text.set_parse_math(False)
        text.set_text(visible(text.get_text()))
    canvas.draw()


def draw_header(figure: Figure, y: float, title: str, caption: str, time: str = '') -> Text:
    """Draw title and caption, as small as needed; return the text of the time between them.

    Parameters
    ----------
    y : float
        Place of their middle, 0 to 1.
    time : str
        The longest text of the time.
    """
    sizes = 11.0, 11.0, 9.0
    line: dict[str, Any] = {'va': 'center', 'parse_math': False}
    texts = (
        figure.text(HEADER_SIDE, y, visible(title), weight='bold', color=INK, **line),
        figure.text(0.5, y, visible(time), color=INK, ha='center', **line),
        figure.text(1.0 - HEADER_SIDE, y, visible(caption), color=MUTED, ha='right', **line),
    )
    for text, size in zip(texts, sizes, strict=True):
        text.set_fontsize(size)
    gaps = 2.0 * HEADER_SIDE * (len(texts) - 1)
    room = (1.0 - 2.0 * HEADER_SIDE - gaps) * figure.bbox.width
    needed = sum(text.get_window_extent().width for text in texts)
    for text, size in zip(texts, sizes, strict=True):
        text.set_fontsize(size * min(1.0, room / needed))
    left, _, right = (text.get_window_extent() for text in texts)
    texts[1].set_x(0.5 * (left.x1 + right.x0) / figure.bbox.width)
    return texts[1]


def _when(phase: str, t: float = LONGEST_TIME) -> str:
    return f't = {t:.2f} s · {phase}' if phase else f't = {t:.2f} s'


def stated(run: RecordedRun, staging: SceneSetup) -> str:
    """Caption of a picture: source of the states, scale of the deflection."""
    where = {'joints': 'joints alone', 'plant': 'true state'}.get(run.source, run.source)
    if not staging.flexible:
        return where
    return f'deflection × {staging.scale:g}, grey: undeflected · {where}'


def _fit(axes: Axes, staging: SceneSetup) -> None:
    """Let the axes show all of the staging, a metre as long to the right as up."""
    low, high = field_of_view(staging)
    box = axes.get_window_extent()
    size = np.array([box.width, box.height])
    half = 0.5 * size * float(((high - low) / size).max())
    middle = 0.5 * (low + high)
    axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
    axes.set_ylim(middle[1] - half[1], middle[1] + half[1])


def field_of_view(staging: SceneSetup) -> tuple[Array, Array]:
    """Corners (2,) of the region that a picture must hold [m]."""
    low, high = staging.low[:2], staging.high[:2]
    if not staging.camera.flat:
        floor = _floor_lines(staging)[0].reshape(-1, 2)
        low, high = np.minimum(low, floor.min(axis=0)), np.maximum(high, floor.max(axis=0))
    pad = MARGIN * float((high - low).max())
    return low - pad, high + pad


def _coordinates(axes: Axes, staging: SceneSetup, numbered: bool) -> None:
    """Draw the grid and the coordinates of a flat view."""
    axes.grid(True, color=GRID, lw=0.7)
    axes.set_axisbelow(True)
    for side in axes.spines.values():
        side.set_color(GRID)
    extent = max(np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim()))
    step = round_up(float(extent) / SQUARES)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(step))
    axes.tick_params(colors=MUTED, labelsize=8, length=0)
    if numbered:
        right, up = ('xyz'[int(np.argmax(row))] for row in staging.camera.axes[:2])
        axes.set_xlabel(f'{right} [m]', size=8, color=MUTED, labelpad=1)
        axes.set_ylabel(f'{up} [m]', size=8, color=MUTED, labelpad=1)
    else:
        axes.tick_params(labelbottom=False, labelleft=False)


def _floor(axes: Axes, staging: SceneSetup, noted: bool) -> None:
    """Draw the floor below the robot, a length on it, and the base's axes."""
    lines, step = _floor_lines(staging)
    axes.add_collection(
        LineCollection(list(lines), colors=GRID, linewidths=0.9, zorder=BEHIND), autolim=False
    )
    axes.set_axis_off()
    arrows = staging.camera.project(0.6 * step * np.eye(3))[:, :2]
    for name, end, colour in zip('xyz', arrows, ('#b91c1c', '#15803d', '#1d4ed8'), strict=True):
        axes.plot([0.0, end[0]], [0.0, end[1]], color=colour, lw=1.4, zorder=BEHIND)
        right, up = (1.15 * end).tolist()
        axes.text(right, up, name, size=8, color=colour, ha='center', va='center')
    if noted:
        note = f'floor: squares of {step:g} m'
        axes.text(0.01, 0.02, note, transform=axes.transAxes, size=8, color=MUTED)


def _floor_lines(staging: SceneSetup) -> tuple[Array, float]:
    """Return the lines (k, 2, 2) of the floor's squares in the picture and their width [m]."""
    low, high = staging.box
    step = round_up(float((high - low)[:2].max()) / SQUARES)
    first, last = np.floor(low[:2] / step), np.ceil(high[:2] / step)
    lines = []
    for along, across in ((0, 1), (1, 0)):
        for k in np.arange(first[across], last[across] + 1):
            ends = np.full((2, 3), low[2])
            ends[:, across] = k * step
            ends[:, along] = first[along] * step, last[along] * step
            lines.append(ends)
    return staging.camera.project(np.array(lines))[:, :, :2], step


def _colour_bar(
    figure: Figure, place: tuple[float, float, float, float], staging: SceneSetup
) -> None:
    axes = figure.add_axes(place)
    shades = strain_colours(np.linspace(-1.0, 1.0, 256), 1.0) / 255.0
    limit = 1e6 * staging.strain
    axes.imshow(
        np.linspace(-limit, limit, 256)[:, np.newaxis],
        cmap=ListedColormap(shades),
        aspect='auto',
        origin='lower',
        extent=(0.0, 1.0, -limit, limit),
    )
    axes.set_xticks([])
    axes.yaxis.tick_right()
    axes.tick_params(colors=MUTED, labelsize=8, length=2)
    figure.text(
        0.985,
        place[1] + place[3] + 0.015,
        'bending\nstrain\n[µm/m]',
        size=8,
        color=MUTED,
        ha='right',
    )
    for side in axes.spines.values():
        side.set_visible(False)


def chart_groups(run: RecordedRun) -> dict[str, list[str]]:
    """Return the channels of each chart, by quantity and unit; not where all of them are 0."""
    groups: dict[str, list[str]] = {}
    for name in run.names:
        groups.setdefault(name.partition('/')[0], []).append(name)
    tell = [group for group, names in groups.items() if any(_peak(run, n) > 0.0 for n in names)]
    return {group: groups[group] for group in tell[:MOST_CHARTS]}


def draw_charts(figure: Figure, run: RecordedRun, groups: dict[str, list[str]]) -> list[Any]:
    """Draw the charts; return the lines that mark the time."""
    cursors = []
    width = 0.93 / max(len(groups), 1)
    for k, (group, names) in enumerate(groups.items()):
        axes = figure.add_axes((0.055 + k * width, 0.07, width - 0.06, 0.15))
        _chart(axes, run, group, names)
        cursors.append(axes.axvline(run.span[0], color=INK, lw=1.0))
    return cursors


def _chart(axes: Axes, run: RecordedRun, group: str, names: Sequence[str]) -> None:
    columns = {name: run.channel(name) for name in names}
    peaks = {name: _peak(run, name) for name in names}
    largest = sorted(names, key=lambda name: -peaks[name])[:MOST_CURVES]
    what, _, unit = group.rstrip(']').partition(' [')
    factor, prefix = si_prefix(max(peaks.values()), SMALLEST) if unit else (1.0, '')
    shown = [name for name in names if name in largest]
    whose = list(dict.fromkeys(_whose(name) for name in shown))
    for name in shown:
        label, colour = name.partition('/')[2], CURVES[whose.index(_whose(name)) % len(CURVES)]
        # predicted over true: dashes leave both to be seen
        style: Any = (0, (3, 2)) if label.startswith('predicted') else 'solid'
        values = columns[name] / factor
        axes.plot(run.t, values, color=colour, lw=1.2, ls=style, label=label)
    left_out = f', {len(shown)} of {len(names)}' if len(shown) < len(names) else ''
    title = f'{what}{left_out} [{prefix}{unit}]' if unit else f'{what}{left_out}'
    axes.set_title(title, loc='left', size=8.5, color=INK, pad=3)
    axes.legend(
        fontsize=6.5, frameon=False, loc='upper left', ncols=LEGEND_COLUMNS,
        handlelength=1.4, columnspacing=0.8, labelcolor=MUTED, borderpad=0.0, labelspacing=0.2,
    )  # fmt: skip
    # The legend has rows of its own above the curves.
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + LEGEND_ROW * -(-len(shown) // LEGEND_COLUMNS) * (high - low))
    start, end = run.span
    axes.set_xlim(start, end if end > start else start + 1.0)
    axes.set_xlabel('time [s]', size=8, color=MUTED, labelpad=1)
    axes.grid(True, color=GRID, lw=0.6)
    axes.tick_params(colors=MUTED, labelsize=7.5, length=2)
    axes.yaxis.set_major_locator(MaxNLocator(4))
    for side in axes.spines.values():
        side.set_color(GRID)


def _peak(run: RecordedRun, name: str) -> float:
    return float(np.nanmax(np.abs(run.channel(name))))


def _whose(name: str) -> str:
    """Quantity of a channel, without its source."""
    return name.partition('/')[2].split(' ', 1)[-1]
