"""`denoc view RUN --video FILE`, `--strip FILE.png`: a recorded run as a film or a picture."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from denoc_ros.cli.progress import Progress
from denoc_ros.cli.recorded_run import OpenedRun, open_run
from denoc_ros.errors import ConfigError

if TYPE_CHECKING:  # an optional extra
    from denoc_ros.viewer.film import Look

VIEWS = ('auto', 'side', 'top', 'front', 'iso')
STRIP_RATE = 60.0  # Hz


def add_film_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options of films and strips."""
    group = parser.add_argument_group('films and pictures of a recorded run, without a display')
    group.add_argument('--video', type=Path, metavar='FILE', help='write a film, .mp4 or .gif')
    group.add_argument(
        '--strip',
        type=Path,
        metavar='FILE',
        help='write some snapshots of the run into one .png',
    )
    group.add_argument(
        '--phases',
        nargs='+',
        default=[],
        metavar='NAME',
        help='phases that the film shows beside each other, each from its beginning',
    )
    group.add_argument(
        '--moments',
        type=int,
        default=6,
        metavar='N',
        help='number of snapshots of the strip, default 6',
    )
    group.add_argument(
        '--speed',
        type=float,
        default=1.0,
        help='speed of the film: 0.1 is ten times slower than real time',
    )
    group.add_argument('--fps', type=float, help='frames per second, default 30, for a GIF 20')
    group.add_argument(
        '--size', default='', metavar='WxH', help='size in pixels, default 1280x720'
    )
    group.add_argument('--view', choices=VIEWS, default='auto', help='direction of view')


def wants_pictures(args: argparse.Namespace) -> bool:
    """Say whether a film or a strip was asked for."""
    return args.video is not None or args.strip is not None


def write_pictures(args: argparse.Namespace, path: Path) -> list[Path]:
    """Write the film and the strip that were asked for.

    Parameters
    ----------
    args : Namespace
        Of `add_film_options` and `add_run_options`, and `scale`.
    path : Path
        The run.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    DenocError
        For a file of another kind, an option that is out of range, or a run without moments.
    """
    from denoc_ros.viewer import film

    rate = STRIP_RATE
    if args.strip is not None:
        film.require_suffix(args.strip, film.STRIP_SUFFIXES)
    if args.video is not None:
        suffix = film.require_suffix(args.video, film.FILM_SUFFIXES)
        fps = film.FPS[suffix] if args.fps is None else args.fps
        film.frame_times(0.0, 1.0, fps, args.speed)
        rate = max(rate, fps / args.speed)
    look = film.Look(args.scale or 0.0, args.view, _size(args.size), phases=tuple(args.phases))
    opened = open_run(args, path, rate)
    look = dataclasses.replace(look, title=opened.title, folder=opened.folder)
    if args.strip is not None:
        film.write_strip(opened.run, opened.robot, args.strip, look, args.moments)
    if args.video is not None:
        _film(args, opened, look)
    return [file for file in (args.strip, args.video) if file is not None]


def _film(args: argparse.Namespace, opened: OpenedRun, look: Look) -> None:
    from denoc_ros.viewer.film import write_film

    run = opened.run
    start, end = run.span
    if look.phases:
        start, end = 0.0, max(b - a for a, b in map(run.phase_span, look.phases))
    with Progress().phase(f'drawing {args.video.name}', end - start) as show:
        write_film(run, opened.robot, args.video, look, args.fps, args.speed, show)


def _size(text: str) -> tuple[int, int]:
    """Return width and height of WxH."""
    if not text:
        return 1280, 720
    width, _, height = text.lower().partition('x')
    try:
        return int(width), int(height)
    except ValueError:
        raise ConfigError('--size', [f'it must be WxH in pixels, got {text!r}']) from None
