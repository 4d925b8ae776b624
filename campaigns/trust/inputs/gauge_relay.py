"""Faults of strain gauges over DDS: a relay between the plant and the predictor changes values.

`python -m campaigns gauges` runs plant, feedforward and predictor as processes in lockstep, once
for each fault and each reference, and prints the errors of the deflection as a table. The exit
status is 1 if an error is beyond its bound or a faulty gauge is not named.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
import threading
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from bench.loops.rates_blocks import domain
from diagnostic_msgs.msg import DiagnosticArray
from fault_draws import Draw, Fault, Message, Streams, faulty_streams
from gauge_runs import ROBOTS
from lockstep_stage import PATIENCE, LockstepStage
from predictor_faults import (
    ALL_FAULTY_FACTOR,
    CLEAR_SIGMAS,
    DETECTION_S,
    FAULTY_FACTOR,
    GAUGES,
    NAMES,
)
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from denoc_ros.bags.reader import read_bag
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.nodes.base.messages import EVERY_MESSAGE
from denoc_ros.nodes.base.simulated_time import TickProgress
from denoc_ros.runtime.loop.status import OK
from denoc_ros.trajectories import CycloidalTrajectory
from denoc_ros.types import Array

ROBOT = ROBOTS / 'canadarm_gauges.urdf'
RATES = {'plant': 250.0, 'feedforward': 250.0, 'predictor': 100.0}  # Hz
START_S = 1.0  # of the motion
REST_S = 2.0  # after the motion
WINDOW_S = 0.35  # of values that the relay keeps, longer than every delay
MOTIONS = {'usual': (0.3, 4.0), 'gentle': (0.05, 8.0)}  # angle of each joint [rad], time [s]
LINKS = ('link_1', 'link_2')
TRUE_TOPIC = 'strain/true'
TRUE_DEFLECTION, ESTIMATE = '/plant/true_deflection', '/predictor/tip_deflection'


def _fault(kind: str, channel: str, size: float = 1.0, other: str = '') -> Fault:
    return Fault(kind, channel, 0.0, size, other)


ROOT_1, MIDDLE_1, ROOT_2, MIDDLE_2 = GAUGES
BOTH = (ROOT_1, MIDDLE_1)
FAULTS: dict[str, tuple[str, tuple[Fault, ...]]] = {
    'none': ('usual', ()),
    'inverted': ('usual', (_fault('inverted', ROOT_1),)),
    'frozen': ('usual', (_fault('frozen', ROOT_2),)),
    'gain': ('usual', (_fault('gain', ROOT_1, 10.0),)),
    'delayed': ('usual', (_fault('delayed', MIDDLE_1, 0.3),)),
    'both-inverted': ('usual', tuple(_fault('inverted', gauge) for gauge in BOTH)),
    'both-frozen': ('usual', tuple(_fault('frozen', gauge) for gauge in BOTH)),
    'swapped': (
        'usual',
        (_fault('swapped', ROOT_1, 1.0, ROOT_2), _fault('swapped', MIDDLE_1, 1.0, MIDDLE_2)),
    ),
    'gentle-none': ('gentle', ()),
    'gentle-inverted': ('gentle', (_fault('inverted', ROOT_1),)),
    'gentle-frozen': ('gentle', (_fault('frozen', ROOT_2),)),
}  # fmt: skip


class Relay(Node):
    """Passes the plant's strain on to the predictor with faults, as a partner of the lockstep.

    Attributes
    ----------
    reports : list
        Time [s], level and message of each status `predictor: fusion`.
    shown : dict of str to float
        When a gauge differed clearly from its true value for the first time [s].
    """

    def __init__(self, faults: Sequence[Fault]) -> None:
        super().__init__('relay', use_global_arguments=False)
        self._faults = faults
        self._kept: Streams = {gauge: [] for gauge in GAUGES}
        sensors = load_robot(ROBOT, gravity=(0, 0, 0)).tree.sensors
        self._noise = {sensor.name: float(sensor.noise) for sensor in sensors}
        self._count, self._now_ns, self._passed_ns = 0, -1, -1
        self.reports: list[tuple[float, bytes, str]] = []
        self.shown: dict[str, float] = {}
        self.clock = SimpleNamespace(stamp_ns=lambda time: round(1e9 * time))
        self._progress = TickProgress(self)
        self._out = self.create_publisher(JointState, 'strain', EVERY_MESSAGE)
        for kind, topic, receive in (
            (JointState, TRUE_TOPIC, self._pass_on),
            (Clock, '/clock', self._on_clock),
            (DiagnosticArray, '/diagnostics', self._on_diagnostics),
        ):
            self.create_subscription(kind, topic, receive, EVERY_MESSAGE)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)
        self._thread = threading.Thread(target=self._executor.spin, daemon=True)
        self._thread.start()

    def has_listener(self) -> bool:
        """Say whether the predictor receives what the relay publishes."""
        listeners = self.get_subscriptions_info_by_topic('/strain')
        return any(each.node_name == 'predictor' for each in listeners)

    def close(self) -> None:
        self._executor.shutdown()
        self._thread.join(5.0)
        self.destroy_node()

    def _on_clock(self, message: Any) -> None:
        self._now_ns = _stamp_ns(message.clock)
        self._answer()

    def _pass_on(self, message: Any) -> None:
        self._passed_ns = _stamp_ns(message.header.stamp)
        values = dict(zip(message.name, message.position, strict=True))
        if self._faults:
            values = self._changed(1e-9 * self._passed_ns, values)
        message.name, message.position = list(values), list(values.values())
        if values:
            self._out.publish(message)
        self._answer()

    def _answer(self) -> None:
        """Let the time go on once all strain of the present moment is passed on."""
        if self._passed_ns >= self._now_ns or self._passed_ns < 0:
            self._progress.tell(1e-9 * (self._now_ns + 1))

    def _changed(self, now: float, values: Mapping[str, float]) -> dict[str, float]:
        """Return the values of a time [s] with the faults."""
        begin = self._faults[0].begin
        for gauge, value in values.items():
            kept = self._kept[gauge]
            kept.append(Message(gauge, now, now, np.array([value])))
            first = next((each for each in kept if each.stamp >= begin), None)
            kept[:] = [each for each in kept if each is first or each.stamp > now - WINDOW_S]
        if now < begin:
            return dict(values)
        self._count += 1  # The random parts of each message differ.
        faults = tuple(replace(fault, seed=self._count) for fault in self._faults)
        signals = {gauge: _interpolation(kept) for gauge, kept in self._kept.items()}
        draw = Draw(0, RATES['plant'], faults)
        found = faulty_streams(draw, self._kept, signals, self._noise)
        newest = {gauge: found[gauge][-1] for gauge in values if found[gauge]}
        changed = {g: float(each.position[0]) for g, each in newest.items() if each.stamp == now}
        for gauge, kept in self._kept.items():
            # The mean over the window: a single difference may be noise.
            pairs = zip(found[gauge], kept, strict=False)
            gaps = [faulty.position - good.position for faulty, good in pairs]
            if gaps and abs(np.mean(gaps)) > CLEAR_SIGMAS * self._noise[gauge]:
                self.shown.setdefault(gauge, now)
        return changed

    def _on_diagnostics(self, message: Any) -> None:
        at = 1e-9 * _stamp_ns(message.header.stamp)
        for status in message.status:
            if status.name == 'predictor: fusion':
                self.reports.append((at, status.level, status.message))


def _stamp_ns(stamp: Any) -> int:
    return int(stamp.sec * 1_000_000_000 + stamp.nanosec)


def _interpolation(kept: Sequence[Message]) -> Any:
    times, values = [each.stamp for each in kept], [each.position[0] for each in kept]
    return lambda at: np.interp(at, times, values)[:, None]


@dataclass(frozen=True)
class Outcome:
    """Errors and reports of one run, from the start of the motion."""

    times: Array  # (k,) [s]
    errors: Array  # (k, links) [m]
    peak: Array  # (links,), of the true deflection [m]
    reports: tuple[tuple[float, bytes, str], ...]
    shown: float  # when all faults had shown clearly [s], NaN without faults

    def rms(self, since: float = START_S) -> Array:
        """Return the rms errors (links,) from a time [s] on."""
        return np.asarray(np.sqrt(np.mean(self.errors[self.times >= since] ** 2, axis=0)))

    @property
    def largest(self) -> Array:
        """Largest errors (links,) [m]."""
        return np.asarray(np.abs(self.errors).max(axis=0))


@cache
def run(motion: str, begin: float, faults: tuple[Fault, ...], unused: tuple[str, ...]) -> Outcome:
    """Carry out a motion.

    Parameters
    ----------
    motion : str
    begin : float
        s from the motion's start to the faults' begin.
    faults : tuple of Fault
    unused : tuple of str
        Gauges that the predictor does not use; with several it uses the joints alone.
    """
    angle, duration = MOTIONS[motion]
    path = CycloidalTrajectory(np.zeros(3), np.full(3, angle / duration), np.full(3, duration))
    more: dict[str, dict[str, Any]] = {name: {'gravity': [0.0, 0.0, 0.0]} for name in RATES}
    partners = ['feedforward', 'predictor', 'recorder', 'relay']
    more['plant'].update({'lockstep.partners': partners, 'real_time_factor': 1.0})
    more['predictor'].update({'strain': 'ignore' if len(unused) > 1 else 'fuse'})
    acting = tuple(replace(fault, begin=START_S + begin) for fault in faults)
    with tempfile.TemporaryDirectory(prefix='relay-') as folder:
        if len(unused) == 1:  # A gauge that messages lack would be reported.
            file = Path(folder) / 'arm.urdf'
            file.write_text(re.sub(rf'<sensor name="{unused[0]}"[^>]*/>', '', ROBOT.read_text()))
            more['predictor']['urdf_path'] = str(file)
        remapped = {'plant': {'strain': TRUE_TOPIC}}
        with LockstepStage(Path(folder) / 'run', str(ROBOT), RATES, more, remapped) as stage:
            relay = Relay(acting)
            try:
                assert stage.client.until(relay.has_listener, PATIENCE), 'predictor: no listener'
                stage.go_to(START_S - 0.5)
                stage.follow(NAMES, path, START_S)
                stage.go_to(START_S + duration + REST_S)
                stage.client.trigger('/recorder/stop')
            finally:
                relay.close()
            truth, estimate = (
                _deflections(stage.bag, topic) for topic in (TRUE_DEFLECTION, ESTIMATE)
            )
    moving = (estimate[:, 0] >= START_S) & (estimate[:, 0] <= truth[-1, 0])
    times = estimate[moving, 0]
    true = np.column_stack([np.interp(times, truth[:, 0], column) for column in truth[:, 1:].T])
    shown = max(relay.shown.values(), default=np.nan)
    peak = np.abs(truth[:, 1:]).max(axis=0)
    return Outcome(times, estimate[moving, 1:] - true, peak, tuple(relay.reports), shown)


def _deflections(bag: Path, topic: str) -> Array:
    """Return times and deflections of both links along y (k, 3)."""
    rows = []
    for each in read_bag(bag, [topic]):
        message = each.message
        names = list(message.name)
        bent = [message.position[names.index(f'{link}/uy')] for link in LINKS]
        rows.append([1e-9 * each.stamp_ns, *bent])
    return np.array(rows)


@dataclass(frozen=True)
class Row:
    """One row of the table; lengths in m, by link."""

    fault: str
    peak: list[float]
    rms: list[float]
    largest: list[float]
    late_rms: list[float]  # after the time that detection may take
    reference: list[float]  # the same without the faulty gauge; with several, of the joints alone
    bound: list[float]  # of `late_rms`
    shown_after: float  # s of motion until all faults had shown clearly
    named_after: float  # s from there to the report that names them; one report a second
    silent: int  # reports OK after that, or after the time that detection may take
    message: str  # of the last report
    is_good: bool

    def cells(self) -> list[str]:
        """Return the row of the printed table; lengths in mm."""
        columns = zip(
            self.rms, self.largest, self.late_rms, self.reference, self.bound, strict=True
        )
        numbers = [' / '.join(f'{1e3 * value:.3g}' for value in values) for values in columns]
        times = [f'{self.shown_after:.2f} s', f'{self.named_after:.1f} s', str(self.silent)]
        return [self.fault, *numbers, *times, self.message, 'yes' if self.is_good else 'NO']


def table_row(name: str, begin: float) -> Row:
    """Run a fault and its references."""
    motion, faults = FAULTS[name]
    gauges = tuple(dict.fromkeys(g for each in faults for g in (each.channel, each.other) if g))
    found, reference, normal = (
        run(motion, begin, *given) for given in ((faults, ()), ((), gauges), ((), ()))
    )
    since = found.shown if faults else START_S
    late = since + DETECTION_S
    factor = ALL_FAULTY_FACTOR if len(gauges) > 1 else FAULTY_FACTOR
    bound = factor * np.maximum(reference.rms(late), normal.rms(late))
    # Several faulty gauges leave no majority that could name them.
    named = [
        at
        for at, level, text in found.reports
        if level != OK and (len(gauges) > 1 or any(each in text for each in gauges))
    ]
    quiet = sum(
        level == OK for at, level, _ in found.reports if at > max([late, *named[:1]]) and faults
    )
    within = bool((found.rms(late) <= bound).all())
    warned = bool(named) if faults else all(level == OK for _, level, _ in found.reports)
    return Row(
        fault=name,
        peak=found.peak.tolist(),
        rms=found.rms().tolist(),
        largest=found.largest.tolist(),
        late_rms=found.rms(late).tolist(),
        reference=reference.rms(late).tolist(),
        bound=bound.tolist(),
        shown_after=since - START_S,
        named_after=min(named, default=np.nan) - since,
        silent=quiet,
        message=found.reports[-1][2],
        is_good=within and warned and not quiet,
    )


HEAD = (
    'fault',
    *(f'{link}: rms / largest / after detection: rms / reference / bound [mm]' for link in LINKS),
    'shown after', 'named after that', 'then OK', 'last report', 'good',
)  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--faults', nargs='+', choices=FAULTS, default=list(FAULTS))
    parser.add_argument('--begin', type=float, default=0.0, help='s after the start of the motion')
    parser.add_argument('--json', type=Path, help='file for errors and reports')
    args = parser.parse_args(argv)
    print(f'| {" | ".join(HEAD)} |\n|{"---|" * len(HEAD)}')
    rows = []
    with domain():
        for name in args.faults:
            rows.append(table_row(name, args.begin))
            print(f'| {" | ".join(rows[-1].cells())} |', flush=True)
    if args.json:
        args.json.write_text(json.dumps([asdict(each) for each in rows], indent=1))
    return 0 if all(each.is_good for each in rows) else 1


if __name__ == '__main__':
    sys.exit(main())
