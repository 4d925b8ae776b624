"""Joints of a table: the columns that are theirs, and the times of the rows."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from denoc_ros.bags.joint_state import FIELDS, JOINT_STATE, JointStateMessage
from denoc_ros.bags.reader import STAMP, Stamp
from denoc_ros.bags.series import JointSeries
from denoc_ros.bags.writer import BagWriter
from denoc_ros.errors import BagError
from denoc_ros.identification.tables.tables import Table, read_table
from denoc_ros.identification.tables.time_columns import UNITS, time_column, unit_of_times
from denoc_ros.settings import positive, setting
from denoc_ros.types import Array

SEPARATORS = './_ '  # between a joint's name and what of it a column holds
LOG = logging.getLogger('denoc_ros')
SHOWN = 20  # names in a message
FEWEST_USED = 0.95  # of the rows: of fewer a result is doubtful
MOST_PER_STAMP = 2.0  # rows, on average, of which one would be used
FIRST_NS = 1_000_000_000  # a stamp of 0 would say that there is none


@dataclass(frozen=True, kw_only=True)
class TableTimes:
    """How the times of a table's rows are read."""

    time: str = setting('', 'column with the times of a table; default: one of the usual names')
    time_unit: str = setting(
        '',
        "unit of a table's times; default: from the column's name (time_ms, t [us]), else s",
        choices=tuple(UNITS),
    )
    # 0: the table has times
    rate: float = positive(0.0, 'sample rate of a table without times', 'Hz')


@dataclass(frozen=True, kw_only=True)
class RecordedWindow(TableTimes):
    """Which part of a recording is read, and by which clock."""

    stamp: Stamp = setting(STAMP)
    begin: float = setting(0.0, 'first time, since the first sample or message', 's')
    end: float = setting(math.inf, 'last time, since the same', 's')


def used_rows(whose: str, used: int, every: int, why: str = '') -> str:
    """Log, once, where not all rows are used; return why that makes a result doubtful, else ''."""
    told = f'{used} of {every} rows are used{f" ({why})" if why else ""}'
    if used < every:
        _warn_once(f'{whose}: {told}')
    return told if used < FEWEST_USED * every else ''


@lru_cache(maxsize=1000)
def _warn_once(text: str) -> None:
    LOG.warning(text)


def joint_columns(
    table: Path,
    given: Mapping[str, Array],
    joints: Sequence[str],
    named: Mapping[str, str],
    fields: Sequence[str] = FIELDS,
) -> dict[tuple[str, str], str]:
    """Return the column of each joint and field that a table has.

    Parameters
    ----------
    named : mapping of str to str
        `joint.field` to the column that it is taken from, whatever the names.

    Raises
    ------
    BagError
        Two columns of a name, or a named one that does not exist.
    """
    found: dict[tuple[str, str], str] = {}
    for joint in joints:
        for field in fields:
            endings = [f'{joint}{separator}{field}' for separator in SEPARATORS]
            matches = [c for c in given if any(_ends(c, ending) for ending in endings)]
            if field == 'position' and not matches:
                matches = [column for column in given if column == joint]
            if len(matches) > 1 and f'{joint}.{field}' not in named:
                raise BagError(
                    f'{table}: {field} of {joint} must be in one column, '
                    f'got {", ".join(matches)}: --column {joint}.{field}=COLUMN'
                )
            if matches:
                found[joint, field] = matches[0]
    for what, column in named.items():
        joint, _, field = what.rpartition('.')
        if joint not in joints or field not in fields:
            raise BagError(
                f'{table}: --column must name JOINT.{"|".join(fields)} of the robot '
                f'({", ".join(joints)}), got {what!r}'
            )
        if column not in given:
            raise BagError(
                f'{table}: --column {what} must be one of {", ".join(list(given)[:SHOWN])}, '
                f'got {column!r}'
            )
        found[joint, field] = column
    return found


def joints_with(given: Mapping[str, Array], fields: Sequence[str]) -> list[str]:
    """Return the joints that have a column of each of these fields."""
    found: dict[str, set[str]] = {}
    for column in given:
        for field in fields:
            for separator in SEPARATORS:
                if column.endswith(f'{separator}{field}'):
                    joint = column.removesuffix(f'{separator}{field}')
                    found.setdefault(joint, set()).add(field)
    return [joint for joint, has in found.items() if joint and len(has) == len(fields)]


def _ends(column: str, ending: str) -> bool:
    """Say whether a column's name is an ending, or has it behind a separator."""
    return column == ending or any(column.endswith(f'{s}{ending}') for s in './')


def shown(names: Sequence[str]) -> str:
    """Return names for a message: all, or the first of many."""
    more = f' and {len(names) - SHOWN} more' if len(names) > SHOWN else ''
    return ', '.join(names[:SHOWN]) + more


def table_times(
    path: Path, columns: Table, times: TableTimes, rows: int
) -> tuple[str, str, Array]:
    """Return a table's column of times, its unit, and the times from the first row on [s].

    Raises
    ------
    BagError
        When there are no times.
    """
    if times.time and times.time not in columns:
        listed = shown(list(columns))
        raise BagError(f'{path}: time must be a column of numbers ({listed}), got {times.time!r}')
    time = times.time or time_column(columns, columns.time)
    rate = times.rate or (1.0 / columns.step if columns.step > 0.0 and not time else 0.0)
    if rate > 0.0:
        return time, times.time_unit or 's', np.arange(rows) / rate
    if not time:
        raise BagError(
            f'{path}: table must have a column of times, got {shown(list(columns))}: name '
            'the one that has them with --time COLUMN, or give the sample rate with --rate HZ'
        )
    t = columns[time]
    unit = times.time_unit or unit_of_times(time, t, columns.units.get(time, ''))
    _require_own_stamps(path, time, t, UNITS[unit])
    return time, unit, (t - t[np.isfinite(t).argmax()]) * UNITS[unit]  # below a row of units


def _require_own_stamps(path: Path, time: str, t: Array, unit: float) -> None:
    """Raise BagError where most rows have the time of another: it counts seconds, say."""
    stamps, counts = np.unique(t[np.isfinite(t)], return_counts=True)
    rows = int(counts.sum())
    if rows < MOST_PER_STAMP * len(stamps):
        return
    usual = float(np.median(counts))
    rate = usual / (unit * float(np.median(np.diff(stamps)))) if len(stamps) > 1 else 0.0
    such = f', such as --rate {rate:.4g}' if rate > 0.0 else ''
    raise BagError(
        f'{path}: {time} must have a stamp of its own in each row, got {usual:g} rows per stamp '
        f'({rows} rows with {len(stamps)} stamps): use --rate{such}'
    )


def joints_of_table(
    path: Path, given: Table, joints: Sequence[str], named: Mapping[str, str], times: TableTimes
) -> JointSeries:
    """Return the joints whose positions a table has; a row without a time has a stamp of 0.

    Raises
    ------
    BagError
        When the table has no times, or no joint's position; or a column does not exist.
    """
    found = joint_columns(path, given, joints, named)
    names = [joint for joint in joints if (joint, 'position') in found]
    if not names:
        raise BagError(
            f'{path}: table must have the position of a joint (columns such as '
            f"'{joints[0]}/position', or named by --column), got {', '.join(list(given)[:SHOWN])}"
        )
    rows = max(len(given[found[name, 'position']]) for name in names)
    _, _, t = table_times(path, given, times, rows)
    require_rows(path, given, found.values(), t)
    missing = np.full(len(t), np.nan)
    fields = {
        field: np.column_stack(
            [given[found[name, field]] if (name, field) in found else missing for name in names]
        )
        for field in FIELDS
    }
    stamps = FIRST_NS + np.rint(1e9 * np.nan_to_num(t)).astype(np.int64)
    stamps[~np.isfinite(t)] = 0
    used, every = len(np.unique(stamps[stamps > 0])), len(t) + given.left_out
    used_rows(str(path), used, every, 'the others have no time, that of another or other cells')
    return JointSeries(t, tuple(names), **fields, stamp_ns=stamps, log_ns=stamps)


def require_rows(path: Path, given: Table, columns: Iterable[str], t: Array) -> None:
    """Raise BagError unless columns of a table are as long as its times."""
    for column in columns:
        if len(given[column]) != len(t):
            raise BagError(
                f'{path}: {column} must have as many values as there are times ({len(t)}), '
                f'got {len(given[column])}'
            )


def bag_of_table(
    table: Path,
    joints: Sequence[str],
    output: Path,
    columns: Mapping[str, str] | None = None,
    times: TableTimes | None = None,
) -> Path:
    """Write a table's rows as JointState messages on `/joint_states`.

    Parameters
    ----------
    joints : sequence of str
        The robot's. A column `elbow/position`, `elbow.velocity` or `elbow_effort`, also with
        something before it (`/joint_states/elbow/effort`), is that of the joint; `elbow` alone is
        its position [rad, m; per s; N m, N].
    columns : mapping of str to str, optional
        `joint.field` to the column that it is taken from, whatever the names.

    Raises
    ------
    BagError
        When the table cannot be read, has no times, or no joint's position; or a column does not
        exist.

    Notes
    -----
    A row without one joint's position leaves that joint out; times count from the table's first.
    """
    given = read_table(table)
    series = joints_of_table(table, given, joints, columns or {}, times or TableTimes())
    rows = series[np.isfinite(series.t)]
    others = [each for each in FIELDS[1:] if np.isfinite(getattr(rows, each)).any()]
    fields = ('position', *others)
    values = np.stack([getattr(rows, field) for field in fields], axis=1)
    encoders: dict[tuple[bool, ...], JointStateMessage] = {}
    with BagWriter(output) as bag:
        bag.add_topic('/joint_states', JOINT_STATE)
        for stamp_ns, row, there in zip(
            rows.stamp_ns.tolist(), values, np.isfinite(rows.position), strict=True
        ):
            present = tuple(there.tolist())
            if not any(present):
                continue
            if present not in encoders:
                names = [
                    name for name, is_here in zip(rows.names, present, strict=True) if is_here
                ]
                encoders[present] = JointStateMessage(names, fields)
            bag.write(
                '/joint_states', stamp_ns, encoders[present].encode(stamp_ns, *row[:, there])
            )
    return output
