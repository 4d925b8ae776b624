"""Commanded and measured positions of joints, from bags and tables."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.bags.digest import file_hash
from denoc_ros.bags.joint_state import JOINT_STATE
from denoc_ros.bags.reader import BagMessage, Stamp, read_bag
from denoc_ros.bags.run import TRAJECTORY, point_columns, point_times
from denoc_ros.bags.series import JointSeries, read_joint_states
from denoc_ros.errors import BagError, ConfigError, IdentificationError
from denoc_ros.estimation.turns import nearest_turns, unwrap_path, without_turns
from denoc_ros.identification.decay.channel import Channel
from denoc_ros.identification.decay.modes import DOUBTFUL, worst
from denoc_ros.identification.servo.servo_fit import Run, ServoFit, fit_servo_runs
from denoc_ros.identification.tables.joint_table import (
    joint_columns,
    joints_with,
    table_times,
    used_rows,
)
from denoc_ros.identification.tables.tables import is_table, read_table
from denoc_ros.output_files import Document, plain
from denoc_ros.settings import setting
from denoc_ros.trajectories import SplineTrajectory
from denoc_ros.types import Array

FIELDS = ('position', 'command')  # of a joint, in a table
ANY_JOINT = np.ones(1, dtype=bool)  # There is no robot here that says which joints are continuous.


@dataclass(frozen=True)
class ServoOptions:
    """Where the commanded and measured positions of joints are."""

    channel: Channel  # topic of the measured joint states; stamps, times of a table, window
    commanded: str = setting(
        '/reference', 'topic of the commands: JointTrajectory, whole or streamed, or JointState'
    )
    # of a table, by `joint.command` or `joint.position`, whatever they are called
    columns: Mapping[str, str] = field(default_factory=dict)
    joints: Sequence[str] = ()  # those to identify; none: all commanded ones

    def chosen(self, names: Sequence[str], where: str) -> list[str]:
        """Return the joints to identify of those that a recording has; ConfigError for others."""
        chosen = list(self.joints or names)
        unknown = [name for name in chosen if name not in names]
        if unknown:
            raise ConfigError(
                'identify servo', [f'--joint must be of {list(names)} on {where}, got {unknown}']
            )
        return chosen


@dataclass(frozen=True)
class Commands:
    """Commands over time."""

    begin_ns: int  # stamp of the first one [ns]: times count from there
    names: tuple[str, ...]  # all joints that are commanded
    # list of (float, tuple of str, SplineTrajectory or array): from when on [s] which joints are
    # told what: a trajectory, or a position that holds until the next one, towards which it goes
    # linearly
    pieces: list[tuple[float, tuple[str, ...], SplineTrajectory | Array]]

    def at(self, t: Array, names: Sequence[str]) -> Array:
        """Return the positions (k, joints) at times (k,) [s]; NaN before a joint's first one."""
        result = np.full((len(t), len(names)), np.nan)
        for column, name in enumerate(names):
            own = [piece for piece in self.pieces if name in piece[1]]
            starts = [piece[0] for piece in own]
            for row, now in enumerate(t.tolist()):
                place = bisect_right(starts, now) - 1
                if place >= 0:
                    after = own[place + 1] if place + 1 < len(own) else None
                    result[row, column] = _position(own[place], after, name, now)
        return result


def _position(
    piece: tuple[float, tuple[str, ...], SplineTrajectory | Array],
    after: tuple[float, tuple[str, ...], SplineTrajectory | Array] | None,
    name: str,
    now: float,
) -> float:
    start, names, what = piece
    if isinstance(what, SplineTrajectory):
        rows = np.zeros((3, what.n))
        what.sample(now - start, *rows)
        return float(rows[0, names.index(name)])
    here = float(what[names.index(name)])
    if after is None or isinstance(after[2], SplineTrajectory):
        return here
    share = (now - start) / (after[0] - start)
    return here + share * (float(after[2][after[1].index(name)]) - here)


def read_commands(path: Path, topic: str, stamp: Stamp = 'header') -> Commands:
    """Read the commands of joints on a topic.

    Raises
    ------
    BagError
        As `read_bag`; a topic of another type, or without positions.
    """
    pieces: list[tuple[int, tuple[str, ...], SplineTrajectory | Array]] = []
    for item in read_bag(path, [topic], stamp):
        if item.type == TRAJECTORY:
            pieces += _trajectory(item)
        elif item.type == JOINT_STATE:
            if len(item.message.position):
                position = np.array(item.message.position, dtype=np.float64)
                pieces.append((item.stamp_ns, tuple(item.message.name), position))
        else:
            raise BagError(
                f'{path}: topic {topic} must be of type {TRAJECTORY} or {JOINT_STATE}, '
                f'got {item.type}'
            )
    if not pieces:
        raise BagError(f'{path}: {topic} must have commanded positions, got none')
    pieces.sort(key=lambda piece: piece[0])
    begin = pieces[0][0]
    names = dict.fromkeys(name for piece in pieces for name in piece[1])
    _unwrap_points(pieces)
    return Commands(
        begin, tuple(names), [(1e-9 * (start - begin), who, what) for start, who, what in pieces]
    )


def _unwrap_points(pieces: list[tuple[int, tuple[str, ...], SplineTrajectory | Array]]) -> None:
    """Remove jumps by a turn from streamed points, name by name, in place."""
    points = [(at, who, what) for at, who, what in pieces if isinstance(what, np.ndarray)]
    for name in dict.fromkeys(name for _, who, _ in points for name in who):
        own = {at: (what, who.index(name)) for at, who, what in points if name in who}
        times = np.array([1e-9 * (at - points[0][0]) for at in own])
        values = _unwrapped(times, np.array([what[place] for what, place in own.values()]))
        for (what, place), value in zip(own.values(), values.tolist(), strict=True):
            what[place] = value


def _trajectory(item: BagMessage) -> list[tuple[int, tuple[str, ...], SplineTrajectory | Array]]:
    """Return a trajectory, or a streamed point, from when it holds; none without points."""
    points = item.message.points
    names = tuple(item.message.joint_names)
    if not points:
        return []
    times, (q, rates, changes) = point_times(points), point_columns(points)
    begin = item.stamp_ns + round(1e9 * times[0])
    if len(points) == 1:
        return [(begin, names, q[0])]
    return [(begin, names, SplineTrajectory(times - times[0], q, rates, changes))]


def servo_runs(
    path: Path, options: ServoOptions, doubts: list[str] | None = None
) -> dict[str, Run]:
    """Return times, commands and positions of each joint of a bag or a table.

    Parameters
    ----------
    doubts : list of str, optional
        Takes why a result is doubtful: too few rows of a table are used.

    Raises
    ------
    BagError, ConfigError, IdentificationError
        It cannot be read, or has no such joints.
    """
    if is_table(path):
        return _of_table(path, options, [] if doubts is None else doubts)
    if options.columns:
        raise BagError(f'{path}: --column must come with a table, got a bag')
    stamp = options.channel.stamp
    commands = read_commands(path, options.commanded, stamp)
    names = options.chosen(commands.names, options.commanded)
    measured = read_joint_states(path, options.channel.topic, names, stamp)
    t, rows = _grid(path, options, commands, measured)
    told = commands.at(t, names)
    found = {}
    for k, name in enumerate(names):
        whole = unbroken(told[:, k])
        found[name] = _in_one_turn(t[whole], told[whole, k], rows[whole, k])
    return found


def _of_table(path: Path, options: ServoOptions, doubts: list[str]) -> dict[str, Run]:
    given, columns, channel = read_table(path), options.columns, options.channel
    told = [name.rpartition('.')[0] for name in columns]
    known = list(dict.fromkeys([*told, *joints_with(given, FIELDS)]))
    if not known:
        raise BagError(
            f'{path}: table must have what a joint is told and its position (columns such as '
            f'elbow/command and elbow/position, or --column elbow.command=COLUMN and '
            f'elbow.position=COLUMN), got {", ".join(list(given)[:20])}'
        )
    names = options.chosen(known, f'the columns of {path}')
    own = {what: one for what, one in columns.items() if what.rpartition('.')[0] in names}
    found = joint_columns(path, given, names, own, FIELDS)
    runs = {}
    for name in names:
        if missing := [field for field in FIELDS if (name, field) not in found]:
            raise BagError(
                f'{path}: {name} must have a column of its {missing[0]}, got '
                f'{", ".join(list(given)[:20])}: --column {name}.{missing[0]}=COLUMN'
            )
        command, position = (given[found[name, field]] for field in ('command', 'position'))
        _, _, t = table_times(path, given, channel, len(position))
        if not len(command) == len(position) == len(t):
            raise BagError(
                f'{path}: columns of {name} must be as long as the times ({len(t)}), got '
                f'{len(command)} and {len(position)}'
            )
        every = given.left_out + np.count_nonzero(np.isfinite(command) | np.isfinite(position))
        whole = np.isfinite(t) & np.isfinite(command) & np.isfinite(position)
        t, command, position = t[whole], command[whole], position[whole]
        later = np.concatenate(([True], np.diff(np.maximum.accumulate(t)) > 0.0))[: len(t)]
        t, command, position = t[later], command[later], position[later]
        command, position = (_unwrapped(t, each) for each in (command, position))
        doubts += filter(None, [used_rows(f'{path}: {name}', len(t), every)])
        if len(t) < 2:
            raise BagError(f'{path}: {name} must have two rows with times, got {len(t)}')
        grid = np.arange(
            t[0] + max(channel.begin, 0.0),
            min(t[-1], t[0] + channel.end) + 1e-9,
            float(np.median(np.diff(t))),
        )
        runs[name] = _in_one_turn(grid, np.interp(grid, t, command), np.interp(grid, t, position))
    return runs


def _unwrapped(t: Array, values: Array) -> Array:
    """Return positions (k,) without jumps by a turn."""
    return unwrap_path(t, values[:, None], ANY_JOINT)[:, 0]


def _in_one_turn(t: Array, command: Array, position: Array) -> Run:
    """Return a run whose positions are in the turn of its commands."""
    turns = nearest_turns(position[:1], command[:1], ANY_JOINT) - position[:1]
    return t, command, position + turns


def joined(runs: Sequence[Run]) -> Run:
    """Return times, commands and positions of runs, one behind the other on one clock."""
    start, times = 0.0, []
    for t, _, _ in runs:
        times.append(t - t[0] + start if len(t) else t)
        start += float(t[-1] - t[0]) + float(t[1] - t[0]) if len(t) > 1 else 0.0
    first, told, was = zip(*runs, strict=True)
    if len(runs) == 1:
        return first[0], told[0], was[0]
    return np.concatenate(times), np.concatenate(told), np.concatenate(was)


def unbroken(values: Array) -> Any:
    """Say which values (k,) are finite, up to the first gap after the first one."""
    finite = np.isfinite(values)
    first = int(np.argmax(finite)) if finite.any() else len(values)
    later = np.flatnonzero(~finite[first:])
    last = first + int(later[0]) if len(later) else len(values)
    return slice(first, last)


def _grid(
    path: Path, options: ServoOptions, commands: Commands, measured: JointSeries
) -> tuple[Array, Array]:
    """Return times (k,) in equal steps by the commands' clock, and positions (k, joints) then."""
    channel = options.channel
    whole = without_turns(measured.since(commands.begin_ns).rising().complete())
    t = whole.t
    first = float(t[0]) if len(t) else 0.0
    low, high = max(0.0, first + channel.begin), 0.0
    if len(t):
        high = min(float(t[-1]), first + channel.end)
    if len(t) < 2 or high <= low:
        raise IdentificationError(
            f'{path}: {channel.topic} must have positions after the first command on '
            f'{options.commanded}, got none'
        )
    step = float(np.median(np.diff(t)))
    grid = np.arange(low, high, step)
    rows = [np.interp(grid, t, column) for column in whole.position.T]
    return grid, np.column_stack(rows)


def identify_servos(
    paths: Sequence[Path], options: ServoOptions
) -> tuple[Document, list[tuple[ServoFit, Run]]]:
    """Identify the servos of joints from recordings, which are fitted together."""
    doubts: list[str] = []
    read = [servo_runs(path, options, doubts) for path in paths]
    found: list[tuple[ServoFit, Run]] = []
    none = []
    for name in dict.fromkeys(name for runs in read for name in runs):
        own = [runs[name] for runs in read if name in runs]
        try:
            found.append((fit_servo_runs(name, own), joined(own)))
        except IdentificationError as error:
            none.append(str(error))
    fits, channel = [fit for fit, _ in found], options.channel
    times = [t for runs in read for t, _, _ in runs.values()]
    document = {
        'kind': 'servo',
        'source': {
            'file': f'{paths[0]}{f" and {len(paths) - 1} more" if len(paths) > 1 else ""}',
            'sha256': ', '.join(file_hash(path) for path in paths),
            'topic': channel.topic,
            'command': options.commanded,
            'stamp': channel.stamp,
            'calibration': {},
        },
        'window': {'begin_s': channel.begin, 'end_s': channel.end},
        'quality': {
            'samples': max((len(t) for t in times), default=0),
            'step_s': max((float(t[1] - t[0]) for t in times if len(t) > 1), default=0.0),
        },
        'method': 'second-order lag with a delay and a gain, output error, least squares',
        'joints': {
            fit.joint: {
                'bandwidth_hz': fit.bandwidth,
                'damping': fit.damping,
                'delay_s': fit.delay,
                'gain': fit.gain,
                'lag_s': fit.lag,
                'interval': fit.interval,
                'offset': fit.offset,
                'lag_rms': fit.distance,
                'residual_rms': fit.residual,
                'runs': fit.runs,
                'verdict': fit.verdict,
                'reasons': fit.reasons,
            }
            for fit in fits
        },
        'not_moved': none,
        'verdict': worst((*(fit.verdict for fit in fits), *[DOUBTFUL] * bool(doubts and fits))),
        'reasons': [
            *(f'{fit.joint}: {reason}' for fit in fits for reason in fit.reasons),
            *doubts,
        ],
    }
    return dict(plain(document)), found
