"""Faults of measurements as data: drawn from a seed, laid over the messages of a good run."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from denoc_ros.types import Array

JOINTS = 'joints'  # channel of the joint states; the others are named after their gauges
FIRST, LAST = 0.3, 1.2  # s within which faults begin
FULL_SCALE = 3e-3  # strain at which an amplifier ends
MICROSTRAIN = 1e6  # a value in another unit, over the right one
USUAL_RATE = 100.0  # Hz
# Hz of all channels; few draws have the highest, which takes the most time
RATES = (5.0, 20.0, 50.0, *(10 * [100.0]), 200.0, 200.0, 1000.0)
PAIRED = 0.4  # share of draws with two faults


@dataclass(frozen=True)
class Message:
    """One message of a channel."""

    channel: str
    arrival: float  # [s]
    stamp: float  # [s]
    position: Array
    velocity: Array | None = None
    faulty: bool = False  # it is not what a good source would have sent, or not then


@dataclass(frozen=True)
class Fault:
    """One fault: its kind, where it is, when it begins, and how large it is."""

    kind: str
    channel: str
    begin: float  # [s]
    size: float
    other: str = ''  # the second channel of faults of two
    joint: int = 0
    seed: int = 0  # of the noise in it


@dataclass(frozen=True)
class Draw:
    """Faults over one run, all from a seed."""

    seed: int
    rate: float  # Hz of all messages
    faults: tuple[Fault, ...]

    @property
    def kinds(self) -> tuple[str, ...]:
        return tuple(fault.kind for fault in self.faults)

    @property
    def begin(self) -> float:
        """When the first fault begins [s]."""
        return min(fault.begin for fault in self.faults)


@dataclass(frozen=True)
class Violation:
    """A broken law."""

    law: str
    seed: int
    scene: str
    kinds: tuple[str, ...]
    detail: str


Streams = dict[str, list[Message]]
Values = Callable[[Array], Array]  # of times [s]
Signals = Mapping[str, Callable[[Array], Array]]  # true values (k, n) of each channel

# kinds of faults ---------------------------------------------------------------------------------

# of a gauge: true value of its own and of another gauge, noise, time since the begin
SENSOR_KINDS = (
    'inverted', 'frozen', 'gain', 'offset', 'drift', 'noise', 'swapped', 'delayed', 'dropped',
    'full_scale', 'wrong_field', 'unit',
)  # fmt: skip
JOINT_KINDS = ('wrap', 'frozen_joint', 'sign_flip', 'step')
# one message, or a few that a receiver can tell from good ones
SINGLE_KINDS = ('position_spike', 'velocity_spike', 'value_spike', 'not_finite')
TIMING_KINDS = ('repeated', 'reordered', 'late', 'future')
KINDS = (*SENSOR_KINDS, *JOINT_KINDS, *SINGLE_KINDS, *TIMING_KINDS)


@dataclass(frozen=True)
class Sources:
    """The channels of a node, and what may happen to them."""

    values: tuple[str, ...]  # channels of plain values, such as gauges
    moving: tuple[str, ...]  # channels of positions and rates
    width: int  # values of a message
    kinds: tuple[str, ...] = KINDS
    rates: tuple[float, ...] = RATES


def drawn(seed: int, sources: Sources) -> Draw:
    """Return the draw of a seed."""
    rng = np.random.default_rng(seed)
    count = 2 if rng.random() < PAIRED else 1
    kinds = rng.choice(sources.kinds, count, replace=False).tolist()
    faults = tuple(_fault(rng, kind, sources) for kind in kinds)
    return Draw(seed, float(rng.choice(sources.rates)), faults)


def _fault(rng: np.random.Generator, kind: str, sources: Sources) -> Fault:
    own, other = [*rng.permutation(sources.values).tolist(), '', ''][:2]
    moves = kind in (*JOINT_KINDS, 'position_spike', 'velocity_spike')
    if kind in (*TIMING_KINDS, 'not_finite') and sources.moving and rng.random() < 0.5:
        moves = True
    if moves or not own:
        own = str(rng.choice(sources.moving))
    sign = float(rng.choice((-1.0, 1.0)))
    sizes: dict[str, Callable[[], float]] = {
        'gain': lambda: 10.0 ** rng.uniform(-1.0, 1.0),
        'offset': lambda: sign * 10.0 ** rng.uniform(0.5, 2.5),  # standard deviations
        'drift': lambda: sign * 10.0 ** rng.uniform(0.5, 2.5),  # the same per second
        'noise': lambda: 100.0,
        'delayed': lambda: rng.uniform(0.05, 0.5),
        'dropped': lambda: 0.9,
        'position_spike': lambda: sign * 10.0 ** rng.uniform(-2.0, 0.7),
        'velocity_spike': lambda: sign * 10.0 ** rng.uniform(-1.0, 1.0),
        'value_spike': lambda: sign * 10.0 ** rng.uniform(1.0, 4.0),
        'step': lambda: sign * 10.0 ** rng.uniform(-3.0, 0.0),
        'late': lambda: rng.uniform(0.05, 0.5),
        'future': lambda: 10.0 ** rng.uniform(-2.0, 2.0),
        'reordered': lambda: rng.uniform(0.015, 0.1),
    }
    size = sizes.get(kind, lambda: sign)()
    begin = float(rng.uniform(FIRST, LAST))
    return Fault(
        kind, own, begin, size, other,
        int(rng.integers(sources.width)), int(rng.integers(1 << 31)),
    )  # fmt: skip


# messages ----------------------------------------------------------------------------------------


def good_streams(
    draw: Draw,
    signals: Signals,
    noise: Mapping[str, float],
    end: float,
    moving: tuple[str, ...] = (JOINTS,),
) -> Streams:
    """Return the messages of a run without faults; signals of `moving` have rates behind."""
    times = np.arange(0.0, end, 1.0 / draw.rate)
    rng = np.random.default_rng(draw.seed + 1)
    streams = {}
    for channel, signal in signals.items():
        values = signal(times)
        if channel in moving:
            half = values.shape[1] // 2
            streams[channel] = [
                Message(channel, t, t, row[:half], row[half:])
                for t, row in zip(times.tolist(), values, strict=True)
            ]
        else:
            values = values + noise[channel] * rng.standard_normal(values.shape)
            streams[channel] = [
                Message(channel, t, t, row) for t, row in zip(times.tolist(), values, strict=True)
            ]
    return streams


def faulty_streams(
    draw: Draw, good: Streams, signals: Signals, noise: Mapping[str, float]
) -> Streams:
    """Return the messages of a run with the faults of a draw."""
    streams = dict(good)
    for fault in draw.faults:
        lay = _sensor_fault if fault.kind in SENSOR_KINDS else _message_fault
        lay(fault, streams, signals, noise)
    return streams


def in_order(streams: Streams) -> list[Message]:
    """Return all messages as they arrive."""
    merged = [message for stream in streams.values() for message in stream]
    return sorted(merged, key=lambda message: message.arrival)


def _sensor_fault(
    fault: Fault, streams: Streams, signals: Signals, noise: Mapping[str, float]
) -> None:
    if fault.kind == 'swapped':
        own, other = fault.channel, fault.other
        exchanged = [
            _replaced(streams[each], fault.begin, [m.position for m in streams[source]])
            for each, source in ((own, other), (other, own))
        ]
        streams[own], streams[other] = exchanged
        return
    rng, stream = np.random.default_rng(fault.seed), streams[fault.channel]
    if fault.kind == 'dropped':
        streams[fault.channel] = [
            m for m in stream if m.arrival < fault.begin or rng.random() > fault.size
        ]
        return
    times = np.array([message.stamp for message in stream])
    values = np.array([message.position for message in stream])
    deviation, since = noise[fault.channel], (times - fault.begin)[:, None]
    signal = signals[fault.channel]
    changed: dict[str, Callable[[], Array]] = {
        'inverted': lambda: -values,
        'frozen': lambda: np.repeat(
            values[[np.searchsorted(times, fault.begin)]], len(times), axis=0
        ),
        'gain': lambda: fault.size * values,
        'offset': lambda: values + fault.size * deviation,
        'drift': lambda: values + fault.size * deviation * since,
        'noise': lambda: values + fault.size * deviation * rng.standard_normal(values.shape),
        'delayed': lambda: signal(np.maximum(times - fault.size, 0.0)) + values - signal(times),
        'full_scale': lambda: np.full_like(values, fault.size * FULL_SCALE),
        'wrong_field': lambda: np.array([m.position for m in streams[fault.other]][: len(times)]),
        'unit': lambda: MICROSTRAIN * values,
    }
    rows = changed[fault.kind]()
    if len(rows) == len(stream):
        streams[fault.channel] = _replaced(stream, fault.begin, list(rows))


def _replaced(stream: list[Message], begin: float, rows: list[Array]) -> list[Message]:
    return [
        replace(message, position=row, faulty=True) if message.arrival >= begin else message
        for message, row in zip(stream, rows, strict=False)
    ]


def _message_fault(
    fault: Fault, streams: Streams, signals: Signals, noise: Mapping[str, float]
) -> None:
    """Change the joints from a time on, or one message."""
    stream, joint = list(streams[fault.channel]), fault.joint
    place = next((k for k, m in enumerate(stream) if m.stamp >= fault.begin), len(stream) - 1)
    one = stream[place]
    if fault.kind in JOINT_KINDS:
        held = one.position[joint]
        for k in range(place, len(stream)):
            message = stream[k]
            position, velocity = message.position.copy(), message.velocity
            assert velocity is not None
            if fault.kind == 'wrap':
                position[joint] -= fault.size * 2.0 * math.pi
            elif fault.kind == 'step':
                position[joint] += fault.size
            else:
                velocity = velocity.copy()
                position[joint] = held if fault.kind == 'frozen_joint' else -position[joint]
                velocity[joint] = 0.0 if fault.kind == 'frozen_joint' else -velocity[joint]
            stream[k] = replace(message, position=position, velocity=velocity, faulty=True)
    elif fault.kind in SINGLE_KINDS:
        position, velocity = one.position.copy(), one.velocity
        if fault.kind == 'not_finite':
            position[joint % len(position)] = fault.size * math.inf
        elif fault.kind == 'value_spike':
            position += fault.size * noise[fault.channel]
        elif fault.kind == 'position_spike':
            position[joint] += fault.size
        else:
            assert velocity is not None
            velocity = velocity.copy()
            velocity[joint] += fault.size
        stream[place] = replace(one, position=position, velocity=velocity, faulty=True)
    elif fault.kind == 'repeated':
        stream.insert(place + 1, replace(one, arrival=one.arrival + 1e-4, faulty=True))
    elif fault.kind == 'future':
        stream[place] = replace(one, stamp=one.stamp + fault.size, faulty=True)
    else:  # reordered or late: after others with newer stamps
        stream[place] = replace(one, arrival=one.arrival + fault.size, faulty=True)
    streams[fault.channel] = stream
