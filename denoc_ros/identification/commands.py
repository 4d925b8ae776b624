"""Commanded joint positions, from a bag's trajectories or joint states."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from denoc_ros.bags.reader import BagMessage, Stamp, read_bag
from denoc_ros.errors import BagError
from denoc_ros.trajectories import SplineTrajectory
from denoc_ros.types import Array

TRAJECTORY = 'trajectory_msgs/msg/JointTrajectory'
STATE = 'sensor_msgs/msg/JointState'


@dataclass(frozen=True)
class Commands:
    """Commands over time.

    Attributes
    ----------
    begin_ns : int
        Stamp of the first one [ns]: times count from there.
    names : tuple of str
        All joints that are commanded.
    pieces : list of (float, tuple of str, SplineTrajectory or array)
        From when on [s] which joints are told what: a trajectory, or a position that holds until
        the next one, towards which it goes linearly.
    """

    begin_ns: int
    names: tuple[str, ...]
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
        elif item.type == STATE:
            if len(item.message.position):
                position = np.array(item.message.position, dtype=np.float64)
                pieces.append((item.stamp_ns, tuple(item.message.name), position))
        else:
            raise BagError(
                f'{path}: topic {topic} must be of type {TRAJECTORY} or {STATE}, got {item.type}'
            )
    if not pieces:
        raise BagError(f'{path}: {topic} must have commanded positions, got none')
    pieces.sort(key=lambda piece: piece[0])
    begin = pieces[0][0]
    names = dict.fromkeys(name for piece in pieces for name in piece[1])
    return Commands(
        begin, tuple(names), [(1e-9 * (start - begin), who, what) for start, who, what in pieces]
    )


def _trajectory(
    item: BagMessage,
) -> list[tuple[int, tuple[str, ...], SplineTrajectory | Array]]:
    """Return a trajectory, or a streamed point, from when it holds; none without points."""
    points = item.message.points
    names = tuple(item.message.joint_names)
    if not points:
        return []
    times = np.array([p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in points])
    q = np.array([p.positions for p in points], dtype=np.float64)
    if len(points) == 1:
        return [(item.stamp_ns + round(1e9 * times[0]), names, q[0])]
    rates, changes = (
        np.array([getattr(p, field) for p in points], dtype=np.float64)
        if all(len(getattr(p, field)) for p in points)
        else None
        for field in ('velocities', 'accelerations')
    )
    begin = item.stamp_ns + round(1e9 * times[0])
    return [(begin, names, SplineTrajectory(times - times[0], q, rates, changes))]
