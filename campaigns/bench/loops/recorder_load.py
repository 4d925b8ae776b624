"""The recorder under load: 50 topics with 5 MB/s in all, of which nothing may be missing.

`python -m campaigns recorder --seconds 600`. The messages of each topic are numbered; the bag has
to have them all. Publishers, recorder and disk share the machine.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from bench.loops.load_bench import RATE, ROOM, SIZE, TOPICS, benched
from bench.loops.publisher import NUMBER, NUMBER_OFFSET
from mcap.reader import make_reader

from denoc_ros.errors import DenocError

DELIVERY = 1.5  # s from the last message to the recorder's next word on /diagnostics


@dataclass
class Recorded:
    """What a recording under load came to."""

    seconds: float
    kept: int
    missing: int
    lost: int  # as the recorder itself counts
    megabytes: float
    processor: dict[str, float]  # shares of a core

    @property
    def met(self) -> bool:
        return self.missing == self.lost == 0 and self.kept > 0

    def text(self) -> str:
        cores = ', '.join(f'{name} {100 * share:.0f} %' for name, share in self.processor.items())
        return (
            f'{self.seconds:.0f} s: {self.kept} messages, {self.megabytes:.0f} MB, '
            f'{self.missing} missing, {self.lost} counted as lost; core: {cores}'
        )


def record(seconds: float) -> Recorded:
    """Record the load; find out whether all of it is there.

    Parameters
    ----------
    seconds : float

    Raises
    ------
    DenocError
        The disk is too small, or the recorder does not find the topics.
    """
    needed = round(TOPICS * RATE * SIZE * seconds) + ROOM
    if shutil.disk_usage(tempfile.gettempdir()).free < needed:
        raise DenocError(f'disk: must have {needed >> 20} MiB free for {seconds:g} s')
    with benched() as bench:
        bench.start_load()
        bench.start_recorder(['/load/*'])
        bench.wait_for_topics()
        before = bench.processes.cpu_seconds()
        begin = time.perf_counter()
        bench.tell('load', True)
        bench.driver.wait(seconds)
        bench.tell('load', False)
        elapsed = time.perf_counter() - begin
        shares = bench.processor(before, elapsed)
        bench.driver.wait(DELIVERY)
        lost = bench.recorded('lost')
        bench.processes.stop('recorder')
        numbers = read_numbers(bench.folder / 'bag')
        size = sum(file.stat().st_size for file in (bench.folder / 'bag').iterdir())
    kept = sum(map(len, numbers.values()))
    return Recorded(elapsed, kept, count_missing(numbers), lost, size / 1e6, shares)


def count_missing(numbers: Mapping[str, Sequence[int]]) -> int:
    """Return how many of the numbers that each topic got are not there.

    Every topic gets the same: what one of them has last, all must have.
    """
    last = max((max(found) for found in numbers.values() if found), default=-1)
    return TOPICS * (last + 1) - sum(len(set(found)) for found in numbers.values())


def read_numbers(bag: Path) -> dict[str, list[int]]:
    """Return the numbers of the load's messages by topic."""
    found: dict[str, list[int]] = {}
    for file in bag.glob('*.mcap'):
        with file.open('rb') as stream:
            for _, channel, message in make_reader(stream).iter_messages():
                (number,) = NUMBER.unpack_from(message.data, NUMBER_OFFSET)
                found.setdefault(channel.topic, []).append(number)
    return found


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--seconds', type=float, default=60.0, help='of recording')
    parser.add_argument('--json', action='store_true', help='print machine-readable JSON')
    args = parser.parse_args(argv)
    try:
        found = record(args.seconds)
    except DenocError as error:
        print(f'recorder_load: {error}', file=sys.stderr)
        return 1
    print(json.dumps(asdict(found) | {'met': found.met}) if args.json else found.text())
    return 0 if found.met else 2


if __name__ == '__main__':
    sys.exit(main())
