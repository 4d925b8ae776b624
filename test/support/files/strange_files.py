"""Files as strangers make them: a physics, and the shape of the file that has its record.

A kind is a pair of both; the seeds go through the pairs.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from scipy.io import savemat
from scipy.signal import lfilter
from strange_records import (
    CLEAN,
    STRANGE,
    Draw,
    Ring,
    StrangeRecord,
    clean_decay,
    free_decay,
    noise_of,
    steady_ring,
    time_grid,
    two_modes,
)

from denoc_ros.identification.decay.channel import Channel
from denoc_ros.types import Array

BEGIN = datetime(2024, 3, 1, 9, 59, 59, 900_000)


def with_hum(draw: Draw) -> StrangeRecord:
    """Return a decay with the hum of the mains, not near its frequency."""
    made = free_decay(draw)
    hum = made.frequency * draw.uniform(2.3, 5.3)
    level = draw.uniform(0.01, 0.05)
    y = made.y + level * np.sin(2.0 * np.pi * hum * made.t + draw.uniform(0.0, 6.0))
    return replace(made, shape='hum', y=y)


def high_passed(draw: Draw) -> StrangeRecord:
    """Return a decay that a charge amplifier has passed, settled, above its corner."""
    ring, t = steady_ring(draw)
    y = ring.values(t)
    step = float(t[1])
    corner = ring.frequency * draw.uniform(0.005, 0.03)
    keep = float(np.exp(-2.0 * np.pi * corner * step))
    passed = lfilter([1.0, -1.0], [1.0, -keep], y)
    noisy = np.asarray(passed) + noise_of(draw, y, draw.uniform(40.0, 60.0))
    return clean_decay('high-passed', ring, t, noisy)


def on_gravity(draw: Draw) -> StrangeRecord:
    """Return a decay of an accelerometer, gravity and a scale with it."""
    made = free_decay(draw)
    scale = 10.0 ** draw.uniform(-6.0, 3.0)
    return replace(made, shape='gravity', y=scale * (9.81 + draw.uniform(0.1, 5.0) * made.y))


def long_ring(draw: Draw) -> StrangeRecord:
    """Return a decay of very little damping."""
    ring = Ring(draw.uniform(5.0, 40.0), draw.uniform(0.0004, 0.0015))
    t = time_grid(draw, ring.frequency, draw.uniform(0.5, 0.8) / (2.0 * np.pi * ring.zeta))
    y = ring.values(t)
    return clean_decay('little damping', ring, t, y + noise_of(draw, y, draw.uniform(40.0, 60.0)))


def short_ring(draw: Draw) -> StrangeRecord:
    """Return a few cycles of a heavily damped mode."""
    ring = Ring(draw.uniform(1.0, 20.0), draw.uniform(0.08, 0.2))
    t = time_grid(draw, ring.frequency, draw.uniform(3.0, 6.0))
    y = ring.values(t)
    return clean_decay('much damping', ring, t, y + noise_of(draw, y, draw.uniform(45.0, 60.0)))


def beating(draw: Draw) -> StrangeRecord:
    """Return the beat of two modes, seen for some beats."""
    ring = Ring(draw.uniform(2.0, 20.0), draw.uniform(0.003, 0.006))
    second = Ring(ring.frequency * draw.uniform(1.06, 1.15), ring.zeta * draw.uniform(0.8, 1.2))
    t = time_grid(draw, ring.frequency, 3.0 / (2.0 * np.pi * ring.zeta))
    y = ring.values(t) + draw.uniform(0.3, 0.7) * second.values(t)
    return clean_decay('beating', ring, t, y + noise_of(draw, y, draw.uniform(45.0, 60.0)))


def in_blocks(draw: Draw) -> StrangeRecord:
    """Return a decay of which blocks of samples are lost."""
    made = free_decay(draw)
    kept = np.ones(made.t.size, bool)
    for _ in range(int(draw.integers(1, 4))):
        first = int(draw.integers(made.t.size // 5, made.t.size))
        kept[first : first + int(draw.integers(3, max(made.t.size // 20, 4)))] = False
    return replace(made, shape='blocks lost', t=made.t[kept], y=made.y[kept])


def stamped_twice(draw: Draw) -> StrangeRecord:
    """Return a decay of which rows are written twice."""
    made = two_modes(draw)
    rows = np.sort(np.append(np.arange(made.t.size), draw.integers(0, made.t.size, 20)))
    return replace(made, shape='rows twice', t=made.t[rows], y=made.y[rows])


def saturated(draw: Draw) -> StrangeRecord:
    """Return a decay of an amplifier that saturates softly: its harmonics are no modes."""
    made = free_decay(draw)
    y = np.tanh(draw.uniform(0.5, 1.5) * made.y)
    # what it does to the envelope is between nothing and the whole of its release
    zeta = made.zeta
    return replace(made, shape='saturated', y=y, is_clean=False, lowest=0.3 * zeta, highest=zeta)


def aliased_tone(draw: Draw) -> StrangeRecord:
    """Return a driven vibration above half the rate."""
    rate = draw.uniform(50.0, 500.0)
    t = np.arange(int(draw.integers(400, 4000))) / rate
    frequency = rate * draw.uniform(1.05, 1.4)
    y = np.sin(2.0 * np.pi * frequency * t)
    return StrangeRecord('aliased tone', t, y + noise_of(draw, y, draw.uniform(30.0, 60.0)), False)


def wandering(draw: Draw) -> StrangeRecord:
    """Return a drift without any ring."""
    t = np.arange(2000) / 200.0
    y = np.cumsum(draw.standard_normal(t.size)) * 0.01
    return StrangeRecord('wandering', t, y + 1e-3 * draw.standard_normal(t.size), False)


def swept_tone(draw: Draw) -> StrangeRecord:
    """Return a driven vibration whose frequency and strength change: a machine that runs down."""
    t = np.arange(3000) / 300.0
    start = draw.uniform(20.0, 60.0)
    rate = start * (1.0 - draw.uniform(0.05, 0.8) * t / t[-1])
    fall = np.exp(-draw.uniform(0.0, 2.0) * t / t[-1])
    y = fall * np.sin(2.0 * np.pi * np.cumsum(rate) / 300.0)
    return StrangeRecord('swept tone', t, y + noise_of(draw, y, draw.uniform(30.0, 60.0)), False)


PHYSICS: tuple[Callable[[Draw], StrangeRecord], ...] = (
    *CLEAN, *STRANGE, with_hum, high_passed, on_gravity, long_ring, short_ring, beating,
    in_blocks, stamped_twice, saturated, aliased_tone, wandering, swept_tone, free_decay,
)  # fmt: skip

Written = tuple[str, Channel]  # the file's ending, and which signal is asked for


def _rows(t: Array, y: Array, template: str) -> str:
    rows = zip(t.tolist(), y.tolist(), strict=True)
    return ''.join(
        template.format(t=a, y=b, at=BEGIN + timedelta(seconds=a), ms=1e3 * a, us=1e6 * a) + '\n'
        for a, b in rows
    )


TEXTS: dict[str, tuple[str, str, str, bool]] = {  # ending, head, row, decimal commas
    'plain': ('csv', 'time,tip\n', '{t:.9f},{y:.9g}', False),
    'decimal commas': ('csv', 'Zeit [s];tip\n', '{t:.9f};{y:.9g}', True),
    'comment': ('txt', '%Time (ms)\ttip\n', '{ms:.6f}\t{y:.9g}', False),
    'title': ('csv', 'Beam 3, 5 kg\nmade by us\n\nTime,tip\n', '{t:.9f},{y:.9g}', False),
    'title, commas': ('csv', 'Beam 3\nRate;5,5\nt;tip\n', '{t:.9f};{y:.9g}', True),
    'units': ('csv', 'time,tip\nms,mm\n', '{ms:.6f},{y:.9g}', False),
    'microseconds': ('tsv', 'stamp_us\ttip\n', '{us:.3f}\t{y:.9g}', False),
    'dates': ('csv', 'timestamp,tip\n', '{at:%Y-%m-%dT%H:%M:%S.%f}Z,{y:.9g}', False),
    'words': ('csv', 'state;time;tip;note\n', 'ok;{t:.9f};{y:.9g};left', False),
    'blanks': ('dat', '# made by us\ntime   tip\n', '  {t:.9f}   {y:.9g}', False),
    'bars': ('txt', 'time | tip | word\n', '{t:.9f} | {y:.9g} | a', False),
    'quoted': ('csv', '"time","tip"\n', '"{t:.9f}","{y:.9g}"', True),
    'footer': ('csv', 'time,tip\n', '{t:.9f},{y:.9g}', False),
}
OTHERS = ('no names', 'utf-16', 'mat', 'json', 'since 1970', 'rows')
SHAPES = (*TEXTS, *OTHERS)


@dataclass(frozen=True)
class StrangeFile:
    """A record with its truth, the shape of its file, and how it is asked for."""

    record: StrangeRecord
    shape: str
    path: Path
    channel: Channel


def strange_file(seed: int, folder: Path) -> StrangeFile:
    """Write the file of a seed; every pair of physics and shape has its turn."""
    made = PHYSICS[seed % len(PHYSICS)](np.random.default_rng([seed, 43]))
    shape = SHAPES[seed % len(SHAPES)]
    t, y = made.t, made.y
    channel = Channel(field='tip')
    if shape in TEXTS:
        ending, head, row, commas = TEXTS[shape]
        body = _rows(t, y, row)
        if commas:
            body = body.replace('.', ',')
        text = head + body + ('end of file\n' if shape == 'footer' else '')
        path = folder / f'{seed}.{ending}'
        path.write_text(text)
    elif shape == 'no names':
        path = folder / f'{seed}.csv'
        path.write_text(_rows(t, y, 'ok,{t:.9f},{y:.9g}'))
        channel = Channel(field='2', time='1')
    elif shape == 'utf-16':
        path = folder / f'{seed}.csv'
        path.write_bytes(('Zeit;tip\n' + _rows(t, y, '{t:.9f};{y:.9g}')).encode('utf-16'))
    elif shape == 'mat':
        path = folder / f'{seed}.mat'
        savemat(path, {'run': {'time': t, 'tip': y}})
        channel = Channel(field='run.tip', time='run.time')
    elif shape == 'json':
        path = folder / f'{seed}.json'
        path.write_text(json.dumps({'time': t.tolist(), 'tip': y.tolist()}))
    elif shape == 'since 1970':
        path = folder / f'{seed}.csv'
        head = 'stamp,tip\n'
        path.write_text(
            head
            + ''.join(f'{1_700_000_000_000_000 + 1e6 * a:.0f},{b:.9g}\n' for a, b in zip(t, y))  # noqa: B905
        )
    else:
        path = folder / f'{seed}.txt'
        rows = (('time', t), ('tip', y))
        path.write_text('\n'.join(','.join([n, *(f'{v:.9g}' for v in x)]) for n, x in rows))
    return StrangeFile(made, shape, path, channel)
