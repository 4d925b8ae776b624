"""Unit of a table's times, and plausibility of their rate."""

from __future__ import annotations

import re

from denoc_ros.identification.records import Record

UNITS = {'s': 1.0, 'ms': 1e-3, 'us': 1e-6, 'ns': 1e-9}
TIME_NAMES = ('time', 't', 'timestamp', 'stamp')
WITH_UNIT = re.compile(
    rf'({"|".join(TIME_NAMES)})[ _\[(]+(s|sec|ms|msec|us|µs|ns)[\])]?', re.IGNORECASE
)
SPELLED = {'sec': 's', 'msec': 'ms', 'µs': 'us'}
SLOWEST, FASTEST = 4.0, 2e6  # Hz: no mechanical record is sampled slower or faster


def is_time(name: str) -> bool:
    """Say whether a column's name is one of times, such as `time` or `t [ms]`."""
    return name.lower() in TIME_NAMES or WITH_UNIT.fullmatch(name.strip()) is not None


def unit_in(name: str) -> str:
    """Return the unit that a column's name gives its times: s, ms, us or ns; s without one."""
    found = WITH_UNIT.fullmatch(name.strip())
    unit = found[2].lower() if found else 's'
    return SPELLED.get(unit, unit)


def doubtful_rate(record: Record) -> str:
    """Return why a record's sample rate is doubted; '' where it can be one."""
    rate = 1.0 / record.step
    if SLOWEST <= rate <= FASTEST:
        return ''
    likely = [unit for unit, size in UNITS.items() if 10.0 <= rate / size <= 1e5]
    hint = f': times may be in {likely[0]}, --time-unit {likely[0]}' if likely else ''
    return f'sampled at {rate:.3g} Hz, as no mechanical record is{hint}'
