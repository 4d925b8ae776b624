"""Random faults of the inputs of each node, in process, and the laws that its output keeps.

`python -m campaigns inputs --count 20000` draws so many faults for each node, without
middleware, and writes the broken laws, each with the seed that repeats it by `--seed`. The tests
run it once, short.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol

import rclpy
from command_faults import FeedforwardFaults, PlantFaults, ShaperFaults
from fault_draws import Violation
from predictor_faults import PredictorFaults
from rclpy.signals import SignalHandlerOptions

SHOWN = 20  # violations that are written one by one


class NodeFaults(Protocol):
    """A node under drawn faults."""

    def kinds(self, seed: int) -> tuple[str, ...]:
        """Return the kinds of the faults of a seed."""

    def violations(self, seed: int) -> list[Violation]:
        """Return the laws that the draw of a seed breaks."""

    def close(self) -> None:
        """End the node."""


NODES: dict[str, Callable[[Path], NodeFaults]] = {
    'predictor': PredictorFaults,
    'feedforward': FeedforwardFaults,
    'shaper': ShaperFaults,
    'plant': PlantFaults,
}


@contextmanager
def under_faults(name: str, folder: Path) -> Iterator[NodeFaults]:
    """Give a node under faults; rclpy must have been started."""
    node = NODES[name](folder)
    try:
        yield node
    finally:
        node.close()


def table(kinds: Counter[str], broken: Sequence[Violation]) -> str:
    """Return the counts of broken laws by kind of fault; draws of two faults count for both."""
    laws = sorted({violation.law for violation in broken})
    counts = Counter((kind, each.law) for each in broken for kind in each.kinds)
    rows = [['fault', 'draws', *laws]]
    for kind in sorted(kinds):
        rows.append([kind, str(kinds[kind]), *(str(counts[kind, law]) for law in laws)])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [[each.rjust(w) for each, w in zip(row, widths, strict=True)] for row in rows]
    return '\n'.join(map('  '.join, lines))


def campaign(
    name: str, seeds: Sequence[int], folder: Path
) -> tuple[Counter[str], list[Violation]]:
    """Return how often each kind was drawn, and the laws that were broken."""
    kinds: Counter[str] = Counter()
    broken: list[Violation] = []
    with under_faults(name, folder) as node:
        for seed in seeds:
            kinds.update(node.kinds(seed))
            broken += node.violations(seed)
    return kinds, broken


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--count', type=int, default=20000, help='draws for each node')
    parser.add_argument('--first', type=int, default=0, help='seed of the first draw')
    parser.add_argument('--seed', type=int, help='repeat the draw of this seed alone')
    parser.add_argument('--node', choices=NODES, help='one node alone; default all')
    parser.add_argument('--json', type=Path, help='file for all broken laws')
    args = parser.parse_args(argv)
    one = args.seed is not None
    seeds = [args.seed] if one else range(args.first, args.first + args.count)
    written: list[dict[str, Any]] = []
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    for name in [args.node] if args.node else NODES:
        with tempfile.TemporaryDirectory(prefix='faults-') as folder:
            kinds, broken = campaign(name, seeds, Path(folder))
        print(f'{name}: {len({v.seed for v in broken})} of {len(seeds)} draws break a law')
        if broken:
            print(table(kinds, broken))
        for violation in broken[: None if one else SHOWN]:
            print(
                f'  --node {name} --seed {violation.seed}: {", ".join(violation.kinds)} '
                f'({violation.scene}): {violation.law}: {violation.detail}'
            )
        written += [{'node': name, **asdict(violation)} for violation in broken]
    rclpy.shutdown()
    if args.json:
        args.json.write_text(json.dumps(written, indent=1))
    return 1 if written else 0


if __name__ == '__main__':
    sys.exit(main())
