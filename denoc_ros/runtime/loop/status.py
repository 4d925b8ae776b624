"""Diagnostics of a node: its loop, its inputs, its real-time options."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from denoc_ros.runtime.inputs.input_monitor import InputMonitor
from denoc_ros.runtime.loop.clocks import SimulatedClock
from denoc_ros.runtime.loop.realtime import refusals
from denoc_ros.runtime.loop.realtime_loop import HISTOGRAM_EDGES, LoopLoad, LoopStatistics

SILENT_CLOCK = 5.0  # s of wall time without a message of /clock
# DiagnosticStatus.level is bytes
OK, WARN, ERROR = b'\x00', b'\x01', b'\x02'


@dataclass
class Status:
    """One DiagnosticStatus to be: its name follows `<node>:` and a blank."""

    name: str
    level: bytes = OK
    message: str = 'ok'
    values: dict[str, object] = field(default_factory=dict)

    def worsen(self, level: bytes, message: str) -> None:
        """Raise the level and say why; the worst comes first."""
        if level > self.level:
            self.message = message if self.level == OK else f'{message}; {self.message}'
            self.level = level
        elif level != OK:
            self.message = f'{self.message}; {message}'


def input_status(monitors: Sequence[InputMonitor], now: float) -> Status:
    """Accepted messages of each topic, and refused ones by cause."""
    status = Status('inputs')
    for monitor in monitors:
        status.values[f'{monitor.topic} accepted'] = monitor.accepted
        age = monitor.age(now)
        status.values[f'{monitor.topic} age_s'] = age if monitor.received else 'never'
        for cause, count in sorted(monitor.rejected.items()):
            status.values[f'{monitor.topic} rejected {cause}'] = count
        refused = sum(monitor.rejected.values())
        if refused > monitor.rejected_reported:
            status.worsen(WARN, f'rejected: {monitor.last_message}')
        monitor.rejected_reported = refused
    return status


def clock_status(clock: SimulatedClock, silence: float, publishers: int) -> Status:
    """Return the simulated time; warns of one that nobody tells, or more than one.

    Parameters
    ----------
    silence : float
        s of wall time since the last message, or since the node waits for one.
    """
    status = Status('clock', message='simulated time')
    status.values = {
        'time_s': 1e-9 * clock.shown_ns if clock.begun else 'never',
        'silence_s': silence,
        'publishers': publishers,
    }
    if not clock.begun or silence > SILENT_CLOCK:
        state = f'time stands at {1e-9 * clock.shown_ns:.3f} s' if clock.begun else 'time waits'
        there = f'/clock has {publishers} publisher{"s" * (publishers != 1)}'
        status.worsen(WARN, f'nothing on /clock for {silence:.1f} s: {state}; {there}')
    if publishers > 1:
        status.worsen(WARN, f'/clock must have one publisher, got {publishers}')
    return status


def loop_status(statistics: LoopStatistics, load: LoopLoad, late_share: float) -> Status:
    """Return the loop's timing; warns of overload, and above a share of late ticks."""
    values: dict[str, object] = {
        'rate_hz': statistics.rate,
        'nominal_rate_hz': 1.0 / load.period,
        'period_p50_us': 1e6 * statistics.period_p50,
        'period_p99_us': 1e6 * statistics.period_p99,
        'period_max_us': 1e6 * statistics.period_max,
        'tick_p50_us': 1e6 * statistics.tick_p50,
        'tick_p99_us': 1e6 * statistics.tick_p99,
        'load': load.share,
        'response_p50_us': 1e6 * load.response,
        'ticks': statistics.ticks_total,
        'overruns': statistics.late,
        'overruns_total': statistics.late_total,
        'skipped_total': statistics.skipped_total,
        'histogram_edges': ' '.join(f'{edge:g}' for edge in HISTOGRAM_EDGES),
        'histogram_counts': ' '.join(str(count) for count in statistics.histogram),
    }
    status = Status('loop', values=values)
    if finding := load.finding:
        status.worsen(WARN, finding)
    if statistics.late_share > late_share:
        status.worsen(
            WARN, f'{100 * statistics.late_share:.1f} % of ticks late by more than half a period'
        )
    return status


def realtime_status(realtime_options: Mapping[str, str]) -> Status:
    """Report real-time options: granted or refused."""
    status = Status('realtime', values=dict(realtime_options))
    for refusal in refusals(realtime_options):
        status.worsen(WARN, refusal)
    return status
