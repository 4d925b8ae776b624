"""Times in a table: the names and units of their columns, dates and times of day."""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import datetime, timedelta, timezone

import numpy as np

from denoc_ros.types import Array

UNITS = {'s': 1.0, 'ms': 1e-3, 'us': 1e-6, 'ns': 1e-9}
TIME_NAMES = ('time', 't', 'timestamp', 'stamp')
OTHER_NAMES = (  # of other programs and languages
    '__time', 'times', 'time stamp', 'time_stamp', 'datetime', 'date_time', 'date time',
    'date/time', 'elapsed', 'elapsed time', 'elapsed_time', 'time elapsed', 'time since start',
    'relative time', 'zeit', 'zeitstempel', 'uhrzeit', 'temps', 'tiempo', 'tempo', 'tid', 'tijd',
)  # fmt: skip
UNIT_NAMES = {
    'second': 's', 'seconds': 's', 'millisecond': 'ms', 'milliseconds': 'ms',
    'microsecond': 'us', 'microseconds': 'us', 'nanosecond': 'ns', 'nanoseconds': 'ns',
}  # fmt: skip
SPELLED = {
    **UNIT_NAMES, 'sec': 's', 'secs': 's', 'msec': 'ms', 'usec': 'us', 'µs': 'us', 'μs': 'us',
    'nsec': 'ns',
}  # fmt: skip
WITH_UNIT = re.compile(
    rf'({"|".join(map(re.escape, (*TIME_NAMES, *OTHER_NAMES)))})'
    rf'(?:[ ,]* in | ?/ ?|[ ,_\[(]+)({"|".join((*UNITS, *SPELLED))})[\])]?',
    re.IGNORECASE,
)
DATE = re.compile(
    r'(?:(?P<y>\d{4})[-/.](?P<m>\d\d?)[-/.](?P<d>\d\d?)|(?P<a>\d\d?)[-/.](?P<b>\d\d?)[-/.](?P<c>\d{4}))'
    r'[T _,]+(?P<time>\d\d?:\d\d(?::\d\d(?:[.,]\d*)?)?) ?(?P<zone>Z|UTC|[+-]\d\d:?\d\d)?'
)
CLOCK = re.compile(r'(?:(\d{1,4}):)?(\d\d?):(\d\d(?:[.,]\d*)?)')
EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
EARLIEST, LATEST = 5e8, 5e9  # s since 1970: times of a computer's clock, 1985 to 2128


def is_time(name: str) -> bool:
    """Say whether a column's name is one of times, such as `time` or `t [ms]`."""
    plain = name.strip().lower()
    known = plain in TIME_NAMES or plain in OTHER_NAMES or plain in UNIT_NAMES
    return known or WITH_UNIT.fullmatch(plain) is not None


def _unit_of(name: str) -> str:
    plain = name.strip().lower()
    found = WITH_UNIT.fullmatch(plain)
    return unit_of_word(found[2] if found else plain if plain in UNIT_NAMES else '')


def unit_of_word(word: str) -> str:
    """Return s, ms, us or ns for how a unit is written; '' where it is none of them."""
    unit = SPELLED.get(word.lower(), word.lower())
    return unit if unit in UNITS else ''


def unit_of_times(name: str, times: Array, below: str = '') -> str:
    """Return the unit of a column of times: s, ms, us or ns.

    Parameters
    ----------
    name : str
        Of the column, which may say it.
    times : (k,) array
        Its values: those of a computer's clock say it by their size.
    """
    said = _unit_of(name) or unit_of_word(below)
    if said:
        return said
    finite = times[np.isfinite(times)]
    first = float(finite[0]) if finite.size else 0.0
    return next((u for u, size in UNITS.items() if EARLIEST <= first * size <= LATEST), 's')


def time_column(columns: Mapping[str, Array], known: str = '') -> str:
    """Return the first column of times that change; '' where there is none.

    Parameters
    ----------
    known : str
        A column that has times, whatever its name.
    """
    named = [name for name in columns if name == known or is_time(name)]
    changing = [name for name in named if np.unique(columns[name][:2]).size > 1]
    return next(iter([*changing, *named]), '')


def seconds_of(cell: str) -> float | None:
    """Return the seconds of a date with a time (since 1970), or of a time of day; else None."""
    cell = cell.strip()
    if ':' not in cell:
        return None
    if found := CLOCK.fullmatch(cell):
        hours, minutes, seconds = found.groups()
        return 3600.0 * int(hours or 0) + 60.0 * int(minutes) + float(seconds.replace(',', '.'))
    date = DATE.fullmatch(cell)
    if date is None:
        return None
    if date['y']:
        year, month, day = int(date['y']), int(date['m']), int(date['d'])
    else:
        day, month, year = int(date['a']), int(date['b']), int(date['c'])
        if month > 12:
            day, month = month, day
    try:
        midnight = datetime(year, month, day, tzinfo=timezone.utc)
    except ValueError:
        return None
    zone = date['zone'] or 'Z'
    if zone[0] in '+-':
        ahead = timedelta(hours=int(zone[1:3]), minutes=int(zone[-2:]))
        midnight -= ahead if zone[0] == '+' else -ahead
    hours, minutes, *rest = date['time'].split(':')
    of_day = 3600.0 * int(hours) + 60.0 * int(minutes)
    of_day += float(rest[0].replace(',', '.')) if rest else 0.0
    return (midnight - EPOCH).total_seconds() + of_day
