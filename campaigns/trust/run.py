"""The fault campaign: everything that must never move a robot wrongly, done to a running node.

`python -m campaigns soak` goes through all faults, in a new order each round, for as long as it is
told, and writes the table. The tests run it once, short.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from trust.disks import full_disk, killed_recorder, short_disk, slow_disk
from trust.endings.ends import killed, told_to_end, unwritable_cache
from trust.faults import FAULTS, run_fault
from trust.outcome import Outcome, markdown, record
from trust.stage import Stage, staged

PROCESS_FAULTS = (told_to_end, killed, unwritable_cache)
DISK_FAULTS = (full_disk, slow_disk, killed_recorder, short_disk)
MARKS = ('<!-- begin faults -->\n', '<!-- end -->')

Act = Callable[[Stage], Outcome]


def acts(seconds: float, exact: bool) -> list[tuple[str, Act]]:
    """Return all faults by name, in the order of the table; arguments as `run_fault`."""
    found: list[tuple[str, Act]] = [
        (fault.name, partial(run_fault, fault=fault, seconds=seconds, exact=exact))
        for fault in FAULTS
    ]
    return found + [(act.__name__, act) for act in (*PROCESS_FAULTS, *DISK_FAULTS)]


def perform(stage: Stage, name: str, act: Act) -> Outcome:
    """Run one fault; a wait without end is a broken law, and the node is started anew."""
    try:
        return act(stage)
    except AssertionError as error:
        stage.processes.stop('feedforward')
        stage.processes.stop('recorder')
        stage.start_feedforward()
        return Outcome(name, '', broken=[str(error)])


def campaign(folder: Path, seconds: float, minutes: float) -> Iterator[tuple[int, str, Outcome]]:
    """Yield (round, name, outcome): one round, and more until the time [min] is over."""
    end = time.perf_counter() + 60.0 * minutes
    chosen = acts(seconds, exact=True)
    turn = 0
    while turn == 0 or time.perf_counter() < end:
        (place := folder / f'round-{turn}').mkdir()
        with staged(place) as stage:
            stage.start_feedforward()
            for name, act in chosen:
                if turn and time.perf_counter() > end:
                    return
                yield turn, name, perform(stage, name, act)
        chosen = random.sample(chosen, len(chosen))
        turn += 1


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--minutes', type=float, default=10.0, help='of rounds; at least one')
    parser.add_argument('--seconds', type=float, default=2.0, help='of each fault of an input')
    parser.add_argument('--table', type=Path, help='Markdown file whose table is written anew')
    parser.add_argument('--json', type=Path, help='file for all outcomes')
    args = parser.parse_args(argv)
    every: list[Outcome] = []
    last: dict[str, Outcome] = {}
    with tempfile.TemporaryDirectory(prefix='campaign-') as folder:
        for turn, name, outcome in campaign(Path(folder), args.seconds, args.minutes):
            every.append(outcome)
            last[name] = outcome if not outcome.broken else last.get(name, outcome)
            verdict = 'BROKEN: ' + '; '.join(outcome.broken) if outcome.broken else 'ok'
            print(f'round {turn}, {outcome.fault}: {outcome.torque}: {verdict}', flush=True)
    broken = sum(bool(outcome.broken) for outcome in every)
    print(f'{len(every)} faults, {broken} broke a law')
    if args.table:
        before, rest = args.table.read_text().split(MARKS[0])
        table = markdown([last[name] for name, _ in acts(args.seconds, exact=True)])
        args.table.write_text(before + MARKS[0] + table + MARKS[1] + rest.split(MARKS[1], 1)[1])
    if args.json:
        args.json.write_text(json.dumps(record(every), indent=2, allow_nan=False))
    return 2 if broken else 0


if __name__ == '__main__':
    sys.exit(main())
