"""Rates: the session of `denoc up` at its update rates, beside bare nodes that do nothing.

Blocks take turns: our four nodes as `denoc up` starts them, then four bare ones that pass messages
of the same topics and sizes around at the same rate (see bare_node.py). Of each block: the share
of deadlines that a loop missed by more than half a period, passed over ones included; messages
that left a publisher since the block began and are not in the bag, found by their checksums; the
share of a core that each process took.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from bench.loops.rates_blocks import LOOPS, NODES, Bench, Block

from denoc_ros.cli.session.session_config import SessionConfig, load_config
from denoc_ros.errors import DenocError

LATE_LIMIT = {1000.0: 0.02, 500.0: 0.005}  # share of deadlines, by rate [Hz]
NAMED = 0.005  # share of a core from which on another process is named
PEER_FACTOR = 1.5  # or so many times what bare nodes show, if that is more


@dataclass(frozen=True)
class Campaign:
    """Both kinds of blocks at one rate."""

    rate: float
    seconds: float
    priority: int
    ours: list[Block]
    bare: list[Block]

    def median(self, kind: str, node: str) -> float:
        return float(np.median([block.loops[node].share for block in getattr(self, kind)]))

    def limit(self, node: str) -> float:
        """Share of deadlines that a loop of ours may miss."""
        return max(LATE_LIMIT.get(self.rate, 0.02), PEER_FACTOR * self.median('bare', node))

    def missing(self, kind: str) -> int:
        return sum(sum(block.missing.values()) for block in getattr(self, kind))

    @property
    def met(self) -> bool:
        kept = all(self.median('ours', node) <= self.limit(node) for node in LOOPS)
        return kept and self.missing('ours') == 0

    def record(self) -> dict[str, Any]:
        """Return plain lists and numbers, ready for JSON."""
        found: dict[str, Any] = {
            'rate': self.rate,
            'seconds': self.seconds,
            'thread_priority': self.priority,
            'met': self.met,
            'limits': {node: self.limit(node) for node in LOOPS},
        }
        for kind in ('ours', 'bare'):
            blocks: list[Block] = getattr(self, kind)
            found[kind] = {
                'late_share': {node: self.median(kind, node) for node in LOOPS},
                'processor': {
                    node: float(np.median([b.processor[node] for b in blocks])) for node in NODES
                },
                'missing': self.missing(kind),
                'published': sum(block.published for block in blocks),
                'blocks': [asdict(block) for block in blocks],
            }
        return found


def measure(
    config: SessionConfig,
    rate: float,
    seconds: float = 15.0,
    blocks: int = 4,
    priority: int | None = None,
) -> Campaign:
    """Run a campaign at one rate.

    Parameters
    ----------
    config : SessionConfig
    rate : float
        Of every loop [Hz].
    seconds : float
        Length of a block.
    blocks : int
        Of each kind.
    priority : int, optional
        SCHED_FIFO priority of every loop, ours and bare; None: as the configuration says.
    """
    with tempfile.TemporaryDirectory(prefix='rates-') as folder:
        bench = Bench(config, rate, seconds, priority, Path(folder))
        ours, bare = [], []
        for index in range(blocks):
            ours.append(bench.ours(index))
            bare.append(bench.bare(index))
    return Campaign(rate, seconds, bench.priority, ours, bare)


def table(campaign: Campaign) -> list[str]:
    """Return a campaign as lines: medians over the blocks, the worst block in brackets."""
    found = campaign.record()
    lines = [
        f'{campaign.rate:g} Hz, {len(campaign.ours)} x {campaign.seconds:g} s of each kind, '
        f'thread_priority {campaign.priority}: {"met" if campaign.met else "MISSED"}',
        f'{"":12}{"late ours (worst)":>20}{"late bare (worst)":>20}{"limit":>8}'
        f'{"p99 ours":>11}{"p99 bare":>11}{"core ours":>11}{"core bare":>11}',
    ]
    for node in NODES:
        line = f'{node:12}'
        if node in LOOPS:
            for blocks in (campaign.ours, campaign.bare):
                shares = [100 * block.loops[node].share for block in blocks]
                line += f'{f"{np.median(shares):.2f} % ({max(shares):.2f})":>20}'
            line += f'{f"{100 * campaign.limit(node):.1f} %":>8}'
            for blocks in (campaign.ours, campaign.bare):
                late = np.median([block.loops[node].late_p99 for block in blocks])
                line += f'{f"{1e3 * late:.2f} ms":>11}'
        else:
            line += ' ' * 70
        for kind in ('ours', 'bare'):
            core = 100 * found[kind]['processor'][node]
            line += f'{f"{core:.0f} %":>11}'
        lines.append(line)
    for kind in ('ours', 'bare'):
        blocks = getattr(campaign, kind)
        lost: Counter[str] = sum((Counter(block.missing) for block in blocks), Counter())
        others: dict[str, float] = {}
        for block in blocks:
            for name, share in block.others.items():
                others[name] = others.get(name, 0.0) + share / len(blocks)
        largest = sorted(others.items(), key=lambda row: -row[1])[:3]
        named = ', '.join(f'{name} {share:.2f}' for name, share in largest if share >= NAMED)
        lines.append(
            f'{kind}: {found[kind]["published"]} messages published, {found[kind]["missing"]} not '
            f'in the bag{f" {dict(lost)}" if lost else ""}; others took '
            f'{sum(others.values()):.2f} cores{f" ({named})" if named else ""}'
        )
    return lines


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--config', default='config/canadarm.yaml', help='of `denoc up`')
    parser.add_argument('--rate', type=float, nargs='+', default=[1000.0, 500.0], help='Hz')
    parser.add_argument('--seconds', type=float, default=15.0, help='of a block, at most 30')
    parser.add_argument('--blocks', type=int, default=4, help='of each kind')
    parser.add_argument('--priority', type=int, help='SCHED_FIFO of every loop; default: config')
    parser.add_argument('--json', action='store_true', help='print machine-readable JSON')
    args = parser.parse_args(argv)
    found = []
    try:
        for rate in args.rate:
            config = load_config(args.config)
            found.append(measure(config, rate, args.seconds, args.blocks, args.priority))
            if not args.json:
                print('\n'.join(table(found[-1])), flush=True)
    except DenocError as error:
        print(f'rates: {error}', file=sys.stderr)
        return 1
    if args.json:
        print(json.dumps([campaign.record() for campaign in found], indent=2, allow_nan=False))
    return 0 if all(campaign.met for campaign in found) else 2


if __name__ == '__main__':
    sys.exit(main())
