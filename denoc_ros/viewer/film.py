"""Films and strips of a recorded run, drawn without a display."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError, DenocError
from denoc_ros.output_files import whole_file
from denoc_ros.settings import declared_findings, documented, setting
from denoc_ros.simulation.recorded.run_snapshots import RecordedRun
from denoc_ros.types import Array
from denoc_ros.viewer.picture import ComparisonPicture, Picture, stated, strip
from denoc_ros.viewer.scene_setup import AUTO, VIEWS, SceneSetup

Pixels = NDArray[np.uint8]

FILM_SUFFIXES, STRIP_SUFFIXES = ('.mp4', '.gif'), ('.png',)
FPS = {'.mp4': 30.0, '.gif': 20.0}
COLOURS = 255  # of a GIF
NEARLY_WHITE = 244  # lighter than any grey that is drawn
STATES = 1000  # that camera, exaggeration and colours are chosen from
PALETTE_FRAMES = 4  # that a GIF's colours are chosen from
GIF_TICK = 10  # ms, in which a GIF counts
SIDES = (160, 4096)  # pixels
NO_ENCODER = 'mp4 needs imageio-ffmpeg ({}): pip install "denoc_ros[viewer]", or write a .gif'


@documented
@dataclass(frozen=True)
class Look:
    """How pictures look.

    Raises
    ------
    ConfigError
        With every value that is out of range.
    """

    scale: float = setting(
        0.0, 'factor that enlarges deflections; 0: chosen so that they are seen', '', 0.0,
        finite=True,
    )  # fmt: skip
    view: str = setting(
        AUTO, 'direction of view; auto: onto the plane of a motion that stays in one, else iso',
        choices=(AUTO, *VIEWS),
    )  # fmt: skip
    size: tuple[int, int] = (1280, 720)  # width and height [pixels], even
    title: str = ''  # above the picture; '': the robot's name
    folder: Path | None = None  # where relative names of mesh files start
    # phases that a film shows beside each other, each from its begin; (): the run as it was
    phases: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        findings = declared_findings(self)
        if not all(SIDES[0] <= side <= SIDES[1] and side % 2 == 0 for side in self.size):
            findings.append(
                f'size must be even numbers of {SIDES[0]} to {SIDES[1]} pixels, '
                f'got {self.size[0]}x{self.size[1]}'
            )
        ConfigError.raise_any('picture', findings)


def frame_times(start: float, end: float, fps: float, speed: float = 1.0) -> Array:
    """Return the times [s] that the frames of a film from start to end show.

    Parameters
    ----------
    start, end : float
        Of the run [s].
    fps : float
        Frames per second of the film.
    speed : float
        Seconds of the run per second of the film.

    Raises
    ------
    ConfigError
        When fps or speed is not a number > 0.
    """
    findings = [
        f'{name} must be > 0, got {value}'
        for name, value in (('fps', fps), ('speed', speed))
        if not 0.0 < value < float('inf')
    ]
    ConfigError.raise_any('film', findings)
    count = max(1, round((end - start) * fps / speed))
    return np.asarray(start + np.arange(count) * (speed / fps))


def require_suffix(path: Path, suffixes: tuple[str, ...]) -> str:
    """Return a file's suffix.

    Raises
    ------
    ConfigError
        When it is none of `suffixes`.
    """
    suffix = path.suffix.lower()
    if suffix not in suffixes:
        raise ConfigError(str(path), [f'the file must end in {" or ".join(suffixes)}'])
    return suffix


def write_film(
    run: RecordedRun,
    robot: Robot,
    path: Path,
    look: Look | None = None,
    fps: float | None = None,
    speed: float = 1.0,
    progress: Callable[[float], object] | None = None,
) -> int:
    """Write a run as a film, MP4 or GIF: its phases, or all of it where it has none.

    Parameters
    ----------
    robot : Robot
        Its workspace is used.
    fps : float, optional
        Frames per second; default 30, of a GIF 20.
    speed : float
        Seconds of the run per second of the film: below 1 is slow motion.
    progress : callable, optional
        Called with the seconds of the run that were drawn.

    Raises
    ------
    ConfigError
        When the suffix is another, or fps or speed is not > 0.
    DenocError
        When the encoder is missing or fails.
    """
    suffix, look = require_suffix(path, FILM_SUFFIXES), look or Look()
    fps = FPS[suffix] if fps is None else fps
    title = look.title or robot.tree.name
    if speed != 1.0:
        title += f', {speed:g} × real time'
    film = _beside(run, robot, look, title) if look.phases else _alone(run, robot, look, title)
    times = frame_times(*film.span, fps, speed)

    def frames() -> Iterator[Pixels]:
        for t in times.tolist():
            yield film.draw(t)
            if progress is not None:
                progress(t - times[0])

    with whole_file(path) as unfinished:
        if suffix == '.gif':
            some = times[np.linspace(0, len(times) - 1, PALETTE_FRAMES).astype(int)]
            palette = _palette([film.draw(t) for t in some.tolist()])
            _write_gif(unfinished, frames(), palette, fps)
        else:
            _write_mp4(unfinished, frames(), look.size, fps)
    return len(times)


class _Film(NamedTuple):
    """The time [s] that a film shows, and its frame at a time."""

    span: tuple[float, float]
    draw: Callable[[float], Pixels]


def _alone(run: RecordedRun, robot: Robot, look: Look, title: str) -> _Film:
    staging = SceneSetup(robot, run.at(_looked_at(*run.span)), look.scale, look.view, look.folder)
    picture = Picture(run, staging, title, look.size)
    return _Film(run.span, lambda t: picture.draw(t, run.at(np.array([t]))[0]))


def _beside(run: RecordedRun, robot: Robot, look: Look, title: str) -> _Film:
    spans = [run.phase_span(name) for name in look.phases]
    states = np.concatenate([run.at(_looked_at(*span)) for span in spans])
    staging = SceneSetup(robot, states, look.scale, look.view, look.folder)
    picture = ComparisonPicture(staging, look.phases, title, stated(run, staging), look.size)

    def draw(t: float) -> Pixels:
        # a phase that is over stays as it ended
        return picture.draw(t, list(run.at(np.array([min(a + t, b) for a, b in spans]))))

    return _Film((0.0, max(b - a for a, b in spans)), draw)


def _looked_at(start: float, end: float) -> Array:
    """Times [s] of the states that set the extent of a film."""
    return np.linspace(start, end, STATES)


def write_strip(
    run: RecordedRun, robot: Robot, path: Path, look: Look | None = None, count: int = 6
) -> None:
    """Write some instants of a run as one PNG.

    Raises
    ------
    ConfigError
        When the suffix is another or count is not 1 .. 24.
    """
    require_suffix(path, STRIP_SUFFIXES)
    image = strip_image(run, robot, look, count)
    with whole_file(path) as unfinished:
        image.save(unfinished, optimize=True)


def strip_image(
    run: RecordedRun, robot: Robot, look: Look | None = None, count: int = 6
) -> Image.Image:
    """Return some instants of a run, evenly over its phases or all of it, as one picture.

    Raises
    ------
    ConfigError
        When count is not 1 .. 24.
    """
    look = look or Look()
    times, staging = _staged_moments(run, robot, look, count)
    pixels = strip(run, staging, look.title or robot.tree.name, look.size, times)
    return _few_colours(pixels)


def moment_images(
    run: RecordedRun, robot: Robot, look: Look | None = None, count: int = 6
) -> list[Image.Image]:
    """Return a picture of each of some instants, from one view: see :func:`strip_image`."""
    look = look or Look()
    times, staging = _staged_moments(run, robot, look, count)
    title = look.title or robot.tree.name
    return [
        _few_colours(strip(run, staging, title, look.size, times[k : k + 1]))
        for k in range(len(times))
    ]


def _staged_moments(
    run: RecordedRun, robot: Robot, look: Look, count: int
) -> tuple[Array, SceneSetup]:
    if not 1 <= count <= 24:
        raise ConfigError('strip', [f'the number of moments must be 1 to 24, got {count}'])
    times = run.moments(count)
    return times, SceneSetup(robot, run.at(times), look.scale, look.view, look.folder)


def _few_colours(pixels: Pixels) -> Image.Image:
    return Image.fromarray(pixels).quantize(256, dither=Image.Dither.NONE)


def _write_mp4(path: Path, frames: Iterable[Pixels], size: tuple[int, int], fps: float) -> None:
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise DenocError(f'{path}: {NO_ENCODER.format(error)}') from error
    encoder = imageio_ffmpeg.write_frames(
        str(path), size, fps=fps, codec='libx264', quality=None, macro_block_size=2,
        output_params=['-crf', '21', '-preset', 'fast', '-movflags', '+faststart'],
        ffmpeg_log_level='error',
    )  # fmt: skip
    try:
        encoder.send(None)
        for frame in frames:
            encoder.send(np.ascontiguousarray(frame))
        encoder.close()
    except OSError as error:
        raise DenocError(f'{path}: the film must be encoded, got: {error}') from error


def _write_gif(path: Path, frames: Iterable[Pixels], palette: Image.Image, fps: float) -> None:
    reduced = (
        Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE)
        for frame in frames
    )
    first = next(reduced)
    first.save(path, save_all=True, append_images=reduced, duration=_Durations(fps), loop=0)


class _Durations(list[int]):
    """Durations [ms] of as many frames as are asked for, in whole ticks that do not drift."""

    def __init__(self, fps: float) -> None:
        super().__init__()
        self._tick = 1e3 / fps / GIF_TICK

    def __getitem__(self, index: Any) -> Any:
        return GIF_TICK * (round((index + 1) * self._tick) - round(index * self._tick))


def _palette(frames: Iterable[Pixels]) -> Image.Image:
    """Return an image with the colours of all frames of a film, so that none flickers.

    Each colour counts once: else the paper would take them all. White stays white.
    """
    every = np.concatenate([np.unique(frame.reshape(-1, 3), axis=0) for frame in frames])
    image = Image.fromarray(np.unique(every, axis=0)[np.newaxis]).quantize(COLOURS)
    colours = np.array(image.getpalette(), dtype=np.uint8).reshape(-1, 3)
    colours[colours.min(axis=1) >= NEARLY_WHITE] = 255
    image.putpalette(colours.tobytes())
    return image
