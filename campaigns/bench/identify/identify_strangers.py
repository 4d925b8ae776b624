"""`denoc identify modal` on files as strangers make them: what is called good, and is not.

Run with `python -m campaigns strangers`.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from strange_files import strange_file
from strange_records import StrangeRecord, strange_record

from denoc_ros.errors import BagError, IdentificationError
from denoc_ros.identification.decay.analysis import analyse_decay
from denoc_ros.identification.decay.channel import read_record
from denoc_ros.identification.decay.modes import GOOD, strongest
from denoc_ros.identification.decay.records import Record

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
    return _judged(made, lambda: Record(made.t, made.y, made.shape))


def judged_file(seed: int, folder: Path) -> Judged:
    """Return what is said of the file of a seed, written into a folder."""
    written = strange_file(seed, folder)
    made = replace(written.record, shape=f'{written.record.shape} | {written.shape}')
    return _judged(made, lambda: read_record(written.path, written.channel).record)


def _judged(made: StrangeRecord, read: Callable[[], Record]) -> Judged:
    try:
        found = analyse_decay(read(), given=made.is_clean).modes
    except (IdentificationError, BagError) as error:
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
    kinds, whole, good = set(), 0, 0
    with TemporaryDirectory() as folder:
        for seed in range(args.first, args.first + args.count):
            one = judged_file(seed, Path(folder))
            kinds.add(one.record.shape)
            words[one.record.shape.partition(' | ')[0], one.verdict] += 1
            whole += one.record.is_clean
            good += one.record.is_clean and one.verdict == GOOD
            if one.is_false_good or (one.record.is_clean and one.verdict != GOOD):
                print(f'{seed}: {one.record.shape}: {one.verdict}: {one.said}', flush=True)
            false += [seed] if one.is_false_good else []
    for (shape, verdict), count in sorted(words.items()):
        print(f'{shape:18} {verdict:17} {count}')
    print(
        f'{args.count} files of {len(kinds)} kinds in {time.process_time() - began:.0f} s: '
        f'{len(false)} false good, {whole - good} of {whole} clean decays not good'
    )
    return int(bool(false) or whole - good >= MOST_REFUSED * whole)


if __name__ == '__main__':
    raise SystemExit(main())
