"""Detection of faulty sensors: false alarms, times to exclusion, errors, and its thresholds.

`python -m campaigns sensors [--count 100] [--alarms] [--sensitivity [NAME ...]] [--json FILE]`

A draw is a random motion of an arm that is richer than the observer's model: beams of clamped-free
shapes, of eight segments, or chains of hinges in MuJoCo, with another stiffness and another load.
The observer gets the joints and gauges with noise; then one kind of fault after another is laid
over the gauges, unless only `--alarms` are wanted. `--sensitivity` halves and doubles each
threshold of `FaultTuning`, or those named.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from fault_draws import (
    JOINTS,
    Draw,
    Fault,
    Message,
    Signals,
    Streams,
    faulty_streams,
    good_streams,
    in_order,
)
from gauge_runs import PAYLOAD, load, recorded
from mujoco_runs import STEP as PLANT_STEP_S
from mujoco_runs import followed

from denoc_ros.dynamics.elastic.deflection import TipDeflections
from denoc_ros.dynamics.robot import Robot
from denoc_ros.estimation.fusion import FusionSettings
from denoc_ros.estimation.observer import Observer
from denoc_ros.estimation.observer_settings import ObserverSettings
from denoc_ros.estimation.sensor_faults import FaultTuning
from denoc_ros.model.plant_description import PlantDescription
from denoc_ros.text_table import text_table
from denoc_ros.types import Array, Flags

TRUTHS = ('clamped-free', 'segments', 'mujoco')
DESCRIPTIONS = {
    'clamped-free': PlantDescription(4, 'clamped-free', 0),
    'segments': PlantDescription(0, '', 8),
    'mujoco': PlantDescription(),
}
HINGES = 16  # per beam, of MuJoCo's chains
ERROR_SHARE = 0.2  # of stiffness and load
SSRMS_EVERY = 5  # Of so many draws one is of the SSRMS, the others are of the Canadarm.
DURATION_S = 8.0
SAMPLE_S, TICK_S = 0.004, 0.01  # s between messages, and between ticks of the observer
MOVES = 6  # of a joint in a draw, at most
FAULT_BEGIN_S, FAULT_END_S = 1.0, 3.0  # Only some faults end.
FALSE_ALARM_SHARE = 0.02  # of the draws, at most
ALARM_S = 0.5  # A healthy sensor that is not used for longer counts as a false alarm.
PATIENCE_S = FusionSettings().patience
NICENESS = 10
FIRST_SEED = 100
SENSITIVITY_CASES = 3  # of a draw

# By name, kind and size of the faults; a second one is on the other gauge of the link and plane.
CASES: dict[str, tuple[tuple[str, float], ...]] = {
    'inverted': (('inverted', 1.0),),
    'frozen': (('frozen', 1.0),),
    'gain 10': (('gain', 10.0),),
    'gain 0.1': (('gain', 0.1),),
    'offset': (('offset', 30.0),),
    'drift': (('drift', 20.0),),
    'noise': (('noise', 100.0),),
    'delayed': (('delayed', 0.3),),
    'full scale': (('full_scale', 1.0),),
    'unit': (('unit', 1.0),),
    'swapped': (('swapped', 1.0),),
    'both of a link': (('inverted', 1.0), ('inverted', 1.0)),
    'inverted, ends': (('inverted', 1.0),),
    'both of a link, ends': (('inverted', 1.0), ('inverted', 1.0)),
}
THRESHOLDS = tuple(field.name for field in fields(FaultTuning))
ENDING = tuple(case for case in CASES if case.endswith(', ends'))

Document = dict[str, Any]


class Scene(NamedTuple):
    """What happens in a draw.

    Attributes
    ----------
    signals : mapping
        True values of the joints and gauges.
    deflection : (ticks, 6 links) array
        At the observer's ticks.
    """

    robot: str
    truth: str
    signals: Signals
    noise: dict[str, float]
    deflection: Array


class Outcome(NamedTuple):
    """What an observer found at its ticks."""

    excluded: Flags  # (ticks, sensors)
    by_joints: Flags  # (ticks,), whether it used the joints alone
    deflection: Array  # (ticks, 6 links)


@dataclass(frozen=True)
class Finding:
    """What became of one fault.

    Attributes
    ----------
    case : str
    seconds : float
        From the fault to the exclusion of a faulty sensor, or of several sensors, to the use of
        the joints alone; inf: never.
    is_named : bool
        Whether it was found, and no healthy sensor was excluded for more than `ALARM_S`.
    ratio : float
        Error of the worst deflection over that of an observer without the faulty sensor; of
        several faulty sensors, over that of the joints alone.
    again : float
        From the end of the fault until all sensors are used for the rest of the draw [s]; inf:
        never.
    """

    case: str
    seconds: float
    is_named: bool
    ratio: float
    again: float


@dataclass(frozen=True)
class Alarms:
    """Seconds for which healthy sensors were not used."""

    excluded: float  # of the worst sensor
    by_joints: float

    @property
    def is_false_alarm(self) -> bool:
        return max(self.excluded, self.by_joints) > ALARM_S


# draws ------------------------------------------------------------------------------------------


def random_motion(
    draw: np.random.Generator, joints: int
) -> Callable[[float], tuple[Array, Array, Array]]:
    """Return a motion of cycloids, one after another for each joint, some with pauses."""
    times = draw.uniform(1.5, 5.0, (joints, MOVES))
    pauses = draw.uniform(0.0, 1.5, times.shape) * (draw.random(times.shape) < 0.5)
    starts = (
        np.cumsum(times + pauses, axis=1) - times - pauses + draw.uniform(0.1, 0.6, (joints, 1))
    )
    ways = draw.uniform(-0.35, 0.35, times.shape) * np.minimum(1.0, times / 4.0)
    rates, turn = ways / times, 2.0 * np.pi

    @lru_cache(maxsize=1)  # An integrator takes one joint after another at the same time.
    def wanted(t: float) -> tuple[Array, Array, Array]:
        share = np.clip((t - starts) / times, 0.0, 1.0)
        sine, cosine = np.sin(turn * share), np.cos(turn * share)
        return (
            (ways * (share - sine / turn)).sum(axis=1),
            (rates * (1.0 - cosine)).sum(axis=1),
            (rates / times * turn * sine).sum(axis=1),
        )

    return wanted


def scene_of(seed: int, duration: float = DURATION_S) -> Scene:
    """Return the draw of a seed."""
    draw = np.random.default_rng(seed)
    name = 'ssrms' if seed % SSRMS_EVERY == SSRMS_EVERY - 1 else 'canadarm'
    truth = TRUTHS[seed % len(TRUTHS)]
    robot = load(name)
    noise = {sensor.name: float(sensor.noise) for sensor in robot.tree.sensors}
    robot = perturbed(robot, draw, DESCRIPTIONS[truth])
    wanted = random_motion(draw, len(robot.joint_names))
    at = robot.joint_indices
    if truth == 'mujoco':
        stamps, motion, strain, deflection = _chain_rows(robot, wanted, duration)
    else:
        method = 'Radau' if truth == 'segments' else 'DOP853'
        data = recorded(robot, wanted, duration, SAMPLE_S, 1e-5, method)
        motion = np.hstack([data.run.q[:, at], data.run.qd[:, at]])
        stamps, strain, deflection = data.run.t, data.strain, data.deflection

    def signal(columns: Array) -> Callable[[Array], Array]:
        return lambda t: np.column_stack([np.interp(t, stamps, each) for each in columns.T])

    signals = {JOINTS: signal(motion)}
    signals |= {gauge: signal(strain[:, [k]]) for k, gauge in enumerate(noise)}
    return Scene(name, truth, signals, noise, signal(deflection)(ticks_of(duration)))


def perturbed(robot: Robot, draw: np.random.Generator, plant: PlantDescription) -> Robot:
    """Return a robot with another stiffness, load and description of its beams."""
    stiffness, load_share = draw.uniform(1.0 - ERROR_SHARE, 1.0 + ERROR_SHARE, 2)
    changes: dict[str, Any] = {'payload.tool.mass': PAYLOAD * load_share}
    for body in robot.tree.bodies:
        beam = body.beam
        for direction, part in (('y', beam and beam.y), ('z', beam and beam.z)):
            if part:
                changes[f'beam.{body.name}.{direction}.ei'] = stiffness * part.stiffness
    robot = robot.with_overrides(changes)
    return robot.with_overrides(plant.overrides(robot.tree)) if plant else robot


def _chain_rows(
    robot: Robot, wanted: Callable[[float], tuple[Array, Array, Array]], duration: float
) -> tuple[Array, Array, Array, Array]:
    """Return stamps, joints' motion, strain and deflections of a robot in MuJoCo."""
    at, rows, links = robot.joint_indices, [], len(TipDeflections(robot).names)
    steps, every = round(duration / PLANT_STEP_S), round(SAMPLE_S / PLANT_STEP_S)
    for now, plant, _ in followed(robot, wanted, steps, every, HINGES):
        bent = np.zeros((2, links))
        plant.tip_deflections(*bent)
        motion = np.concatenate((plant.q[at], plant.qd[at]))
        rows.append((now, motion, plant.sensor_values().copy(), bent[0]))
    columns: list[Array] = [np.array(part) for part in zip(*rows, strict=True)]
    stamps, motions, strain, deflection = columns
    return stamps, motions, strain, deflection


def ticks_of(duration: float) -> Array:
    """Return the times of the observer's ticks [s]."""
    return np.asarray(TICK_S * np.arange(1, round(duration / TICK_S)), dtype=np.float64)


def good_messages(scene: Scene, seed: int) -> Streams:
    """Return the messages of healthy sensors."""
    duration = TICK_S * (len(scene.deflection) + 1)
    return good_streams(Draw(seed, 1.0 / SAMPLE_S, ()), scene.signals, scene.noise, duration)


def faults_of(case: str, scene: Scene, seed: int) -> tuple[Fault, ...]:
    """Return the faults of a case in a draw, on random gauges."""
    draw = np.random.default_rng([seed, 1])
    gauges = list(scene.noise)
    own = int(draw.integers(len(gauges)))
    partner = own ^ 1  # Gauges of a link and plane follow each other in the robots' files.
    other = str(draw.choice([gauge for gauge in gauges if gauge != gauges[own]]))
    return tuple(
        Fault(kind, gauges[place], FAULT_BEGIN_S, size, other, seed=seed)
        for (kind, size), place in zip(CASES[case], (own, partner), strict=False)
    )


def faulty_gauges(faults: Sequence[Fault]) -> frozenset[str]:
    """Return the gauges whose values faults change."""
    found = {fault.channel for fault in faults}
    return frozenset(found | {fault.other for fault in faults if fault.kind == 'swapped'})


# runs -------------------------------------------------------------------------------------------


def observed(
    scene: Scene,
    messages: Sequence[Message],
    tuning: FaultTuning | None = None,
    patience: float = PATIENCE_S,
) -> Outcome:
    """Run an observer over messages in the order of their arrival."""
    robot = load(scene.robot)
    robot.set_payload('tool', PAYLOAD)
    found = Observer(
        robot, ObserverSettings(step=TICK_S, fusion=FusionSettings(patience=patience))
    )
    assert found.fusion is not None
    faults = found.fusion.faults
    if tuning is not None:
        faults.tuning = tuning  # The first measurement resets the detection.
    places = {gauge: place for place, gauge in enumerate(scene.noise)}
    excluded, by_joints, deflection = [], [], []
    rest = iter([*messages, Message('', np.inf, np.inf, np.zeros(0))])
    message = next(rest)
    for k in range(len(scene.deflection)):
        now = TICK_S * (k + 1)
        while message.arrival <= now + 1e-9:
            if message.channel == JOINTS:
                found.measure(message.stamp, message.position, message.velocity)
            else:
                value = float(message.position[0])
                found.sense(places[message.channel], message.stamp, value)
            message = next(rest)
        found.tick(now)
        excluded.append(~faults.trusted)
        by_joints.append(faults.uses_joints_only)
        deflection.append(found.deflections.evaluate(found.q, found.qd)[0].copy())
    return Outcome(np.array(excluded), np.array(by_joints), np.array(deflection))


class Trial:
    """A draw with its healthy messages, and what observers make of them.

    Parameters
    ----------
    seed : int
        Of motion, truth, noise and places of faults.
    duration : float
        [s]
    """

    def __init__(self, seed: int, duration: float = DURATION_S) -> None:
        self.seed, self.scene = seed, scene_of(seed, duration)
        self.good = good_messages(self.scene, seed)
        peak = np.abs(self.scene.deflection).max(axis=0)
        names = TipDeflections(load(self.scene.robot)).names
        bends = np.array([name.endswith(('uy', 'uz')) for name in names])
        self._moves = bends & (peak > 1e-3)
        self._errors: dict[frozenset[str], Array] = {}

    def alarms(self, tuning: FaultTuning | None = None) -> Alarms:
        """Return for how long healthy sensors are not used."""
        outcome = observed(self.scene, in_order(self.good), tuning)
        excluded = TICK_S * outcome.excluded.sum(axis=0).max()
        return Alarms(float(excluded), TICK_S * float(outcome.by_joints.sum()))

    def finding(
        self, case: str, tuning: FaultTuning | None = None, patience: float = PATIENCE_S
    ) -> Finding:
        """Return what becomes of the faults of a case."""
        faults = faults_of(case, self.scene, self.seed)
        draw = Draw(self.seed, 1.0 / SAMPLE_S, faults)
        streams = faulty_streams(draw, self.good, self.scene.signals, self.scene.noise)
        missing = faulty_gauges(faults)
        if case in ENDING:
            for gauge in missing:
                both = zip(streams[gauge], self.good[gauge], strict=True)
                streams[gauge] = [bad if bad.stamp < FAULT_END_S else good for bad, good in both]
        outcome = observed(self.scene, in_order(streams), tuning, patience)
        bad = np.array([gauge in missing for gauge in self.scene.noise])
        found: Flags = np.any(outcome.excluded[:, bad], axis=1)
        if len(missing) > 1:
            found |= outcome.by_joints
        ticks = TICK_S * np.arange(1, len(found) + 1)
        at = np.flatnonzero(found & (ticks >= FAULT_BEGIN_S))
        seconds = float(ticks[at[0]]) - FAULT_BEGIN_S if len(at) else np.inf
        # Where the joints alone are used, no sensor is taken for the cause.
        blamed = outcome.excluded[:, ~bad] & ~outcome.by_joints[:, None]
        wrong = TICK_S * blamed.sum(axis=0).max(initial=0)
        ratio = self.error(outcome) / self._error_without(missing)
        unused = np.flatnonzero(outcome.excluded.any(axis=1) | outcome.by_joints)
        last = float(ticks[unused[-1]]) if len(unused) else 0.0
        again = max(last - FAULT_END_S, 0.0) if last < ticks[-1] else np.inf
        is_named = bool(len(at) and wrong <= ALARM_S)
        return Finding(case, seconds, is_named, float(ratio.max()), again)

    def error(self, outcome: Outcome) -> Array:
        """Return the rms errors of the deflections that move, from the fault on."""
        rows = slice(round(FAULT_BEGIN_S / TICK_S), None)
        gap = outcome.deflection[rows] - self.scene.deflection[rows]
        return np.asarray(np.sqrt(np.mean(gap**2, axis=0))[self._moves])

    def _error_without(self, missing: frozenset[str]) -> Array:
        """Return the errors of an observer without some gauges; of several, without any."""
        if len(missing) > 1:
            missing = frozenset(self.scene.noise)
        if missing not in self._errors:
            streams = {name: each for name, each in self.good.items() if name not in missing}
            self._errors[missing] = self.error(observed(self.scene, in_order(streams)))
        return self._errors[missing]


# campaign ---------------------------------------------------------------------------------------


def benchmark(seed: int, cases: Sequence[str] = tuple(CASES)) -> Document:
    """Return the alarms of a draw, and what becomes of each fault."""
    trial = Trial(seed)
    return {
        'seed': seed,
        'robot': trial.scene.robot,
        'truth': trial.scene.truth,
        'alarms': asdict(trial.alarms()),
        'findings': [asdict(trial.finding(case)) for case in cases],
    }


def variants(names: Sequence[str] = THRESHOLDS) -> Iterator[tuple[str, FaultTuning]]:
    """Yield the thresholds, and those of which one is halved or doubled, by name."""
    tuning = FaultTuning()
    yield 'as they are', tuning
    for name in names:
        for factor in (0.5, 2.0):
            value = factor * getattr(tuning, name)
            yield f'{name} x {factor:g}', replace(tuning, **{name: value})


def sensitivity(seed: int, names: Sequence[str] = THRESHOLDS) -> Document:
    """Return the alarms of a draw, and what becomes of some faults, for each variant."""
    trial, lasting = Trial(seed), [case for case in CASES if case not in ENDING]
    first = seed * SENSITIVITY_CASES
    cases = [lasting[(first + k) % len(lasting)] for k in range(SENSITIVITY_CASES)]
    cases += ENDING
    return {
        'seed': seed,
        'robot': trial.scene.robot,
        'truth': trial.scene.truth,
        'variants': {
            name: {
                'alarms': asdict(trial.alarms(tuning)),
                'findings': [asdict(trial.finding(case, tuning)) for case in cases],
            }
            for name, tuning in variants(names)
        },
    }


def alarm_rows(draws: Sequence[Document]) -> list[Document]:
    """Return the false alarms by robot and truth."""
    rows = []
    for key in sorted({(draw['robot'], draw['truth']) for draw in draws}):
        own = [Alarms(**d['alarms']) for d in draws if (d['robot'], d['truth']) == key]
        rows.append(
            {
                'robot': key[0],
                'truth': key[1],
                'draws': len(own),
                'false alarms': sum(each.is_false_alarm for each in own),
                'longest exclusion [s]': _short(max(each.excluded for each in own)),
                'longest by joints [s]': _short(max(each.by_joints for each in own)),
            }
        )
    return rows


def finding_row(findings: Sequence[Finding]) -> Document:
    """Return the measures of some findings."""
    seconds = [each.seconds for each in findings]
    ratios = [each.ratio for each in findings]
    ended = [each.again for each in findings if each.case in ENDING]
    return {
        'faults': len(findings),
        'median [s]': _short(_quantile(seconds, 0.5)),
        '90 % [s]': _short(_quantile(seconds, 0.9)),
        'named': _short(sum(each.is_named for each in findings) / len(findings)),
        'median ratio': _short(_quantile(ratios, 0.5)),
        'largest ratio': _short(max(ratios)),
        'used again [s]': _short(_quantile(ended, 0.5)) if ended else '',
    }


def case_rows(draws: Sequence[Document]) -> list[Document]:
    """Return the measures by kind of fault."""
    every = [Finding(**each) for draw in draws for each in draw['findings']]
    return [
        {'fault': case, **finding_row([each for each in every if each.case == case])}
        for case in CASES
    ]


def variant_rows(draws: Sequence[Document]) -> list[Document]:
    """Return the measures by variant of the thresholds."""
    rows = []
    plain = [draw['variants']['as they are'] for draw in draws]
    for name in draws[0]['variants']:
        own = [draw['variants'][name] for draw in draws]
        alarms = [Alarms(**each['alarms']) for each in own]
        findings = [Finding(**found) for each in own for found in each['findings']]
        rows.append(
            {
                'threshold': name,
                'false alarms': sum(each.is_false_alarm for each in alarms),
                'longest alarm [s]': _short(max(max(a.excluded, a.by_joints) for a in alarms)),
                **finding_row(findings),
                'changed': sum(a != b for a, b in zip(plain, own, strict=True)),
            }
        )
    return rows


def _quantile(values: Sequence[float], share: float) -> float:
    """Return the smallest value that so large a share does not exceed; it may be infinite."""
    return float(np.quantile(values, share, method='inverted_cdf'))


def _short(value: float) -> str:
    return f'{value:.3g}'


def main() -> int:
    """Run the campaign; the exit status says whether false alarms are rare enough."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument('--count', type=int, default=100, help='draws')
    parser.add_argument('--first', type=int, default=FIRST_SEED, help='the first seed')
    parser.add_argument(
        '--alarms', action='store_true', help='healthy sensors only: no faults are laid over them'
    )
    parser.add_argument(
        '--sensitivity', nargs='*', choices=THRESHOLDS, metavar='NAME',
        help='halve and double each threshold, or those named',
    )  # fmt: skip
    parser.add_argument('--workers', type=int, default=2)
    parser.add_argument('--json', type=Path, help='the results of all draws; it grows with each')
    args = parser.parse_args()
    # Matrices are small: more threads would wait for each other.
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
    context = multiprocessing.get_context('spawn')
    seeds = range(args.first, args.first + args.count)
    work: Callable[[int], Document] = partial(benchmark, cases=() if args.alarms else tuple(CASES))
    if args.sensitivity is not None:
        work = partial(sensitivity, names=args.sensitivity or THRESHOLDS)
    draws: list[Document] = []
    with ProcessPoolExecutor(args.workers, context, os.nice, (NICENESS,)) as pool:
        for draw in pool.map(work, seeds):
            draws.append(draw)
            if args.json is not None:
                args.json.write_text(json.dumps(draws, indent=1), encoding='utf-8')
    if args.sensitivity is not None:
        print(text_table(variant_rows(draws)))
        return 0
    print(text_table(alarm_rows(draws)))
    if not args.alarms:
        print(text_table(case_rows(draws)))
    false = sum(Alarms(**draw['alarms']).is_false_alarm for draw in draws)
    print(f'false alarms: {false} of {len(draws)} draws')
    return 0 if false <= FALSE_ALARM_SHARE * len(draws) else 1


if __name__ == '__main__':
    raise SystemExit(main())
