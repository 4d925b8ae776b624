"""`denoc identify modal` on records as strangers make them: what is called good, and is not.

Run with `make strangers`, or `PYTHONPATH=test:test/support python -m bench.identify_strangers`.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from dataclasses import dataclass

import numpy as np
from strange_records import StrangeRecord, strange_record

from denoc_ros.errors import IdentificationError
from denoc_ros.identification.analysis import analyse_decay
from denoc_ros.identification.modes import GOOD, strongest
from denoc_ros.identification.records import Record

MOST_REFUSED = 0.05  # of clean decays


@dataclass(frozen=True)
class Judged:
    """A record, what was said of its strongest mode, and whether that is a false good."""

    record: StrangeRecord
    verdict: str
    is_false_good: bool
    said: str


def judged(seed: int) -> Judged:
    """Return what is said of the record of a seed."""
    made = strange_record(seed)
    try:
        found = analyse_decay(Record(made.t, made.y, made.shape), given=made.is_clean).modes
    except IdentificationError as error:
        return Judged(made, 'refused', False, str(error))
    if not len(found.frequency):
        return Judged(made, 'refused', False, '; '.join(found.remarks))
    k = strongest(found.frequency, found.energy)[0]
    frequency, interval = float(found.frequency[k]), found.interval[k]
    said = (
        f'{frequency:.4g} Hz ({made.frequency:.4g}), zeta {found.damping_ratio[k]:.4g} '
        f'{np.array2string(interval, precision=5)} ({made.lowest:.4g} .. {made.highest:.4g}); '
        f'{"; ".join(found.reasons[k])}'
    )
    is_good = found.verdict[k] == GOOD
    is_false = is_good and made.is_false_good(frequency, interval)
    return Judged(made, found.verdict[k], is_false, said)


def main() -> int:
    """Run the campaign; the exit status says whether its limits hold."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--count', type=int, default=500)
    parser.add_argument('--first', type=int, default=0, help='the first seed')
    args = parser.parse_args()
    began, words, false = time.process_time(), Counter[tuple[str, str]](), []
    for seed in range(args.first, args.first + args.count):
        one = judged(seed)
        words[one.record.shape, one.verdict] += 1
        if one.is_false_good or (one.record.is_clean and one.verdict != GOOD):
            print(f'{seed}: {one.record.shape}: {one.verdict}: {one.said}', flush=True)
        false += [seed] if one.is_false_good else []
    for (shape, verdict), count in sorted(words.items()):
        print(f'{shape:18} {verdict:17} {count}')
    clean = {shape for shape, _ in words} & {
        'free decay', 'drift', 'coarse', 'clipped', 'two modes', 'lossy',
    }  # fmt: skip
    whole = sum(count for (shape, _), count in words.items() if shape in clean)
    good = sum(
        count for (shape, verdict), count in words.items() if shape in clean and verdict == GOOD
    )
    print(
        f'{args.count} records in {time.process_time() - began:.0f} s: {len(false)} false good, '
        f'{whole - good} of {whole} clean decays not good'
    )
    return int(bool(false) or whole - good > MOST_REFUSED * whole)


if __name__ == '__main__':
    raise SystemExit(main())
