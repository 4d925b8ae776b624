"""What a fault led to, the laws it is held to, and the table of all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from trust.stage import DELTA, LIMITS, RATE, Torques

# s: Fast DDS may stand still for 333 ms when a participant joins, twice when it leaves as well
LONGEST_PAUSE = 1.0
ROUNDING = 1e-9


@dataclass
class Outcome:
    """One row: what was sent, what the torque did, what /diagnostics said, what was lost."""

    fault: str
    sent: str
    torque: str = ''
    diagnostics: str = ''
    lost: str = 'nothing'
    broken: list[str] = field(default_factory=list)  # laws that did not hold

    def require(self, held: object, law: str) -> None:
        if not held:
            self.broken.append(law)


def judge_torques(outcome: Outcome, torques: Torques, silent: bool = False) -> None:
    """Hold what left to the laws that hold whatever comes in.

    Parameters
    ----------
    outcome : Outcome
        Is told what broke.
    torques : Torques
        All that came from before the fault until after the recovery.
    silent : bool
        Whether the node was to be silent for a while.
    """
    effort = torques.effort
    outcome.require(len(effort) > 0, 'torque must leave, got none')
    if not len(effort):
        return
    outcome.require(np.isfinite(effort).all(), 'torque must be finite')
    largest = np.abs(effort).max(axis=0)
    outcome.require(
        (largest <= np.array(LIMITS)).all(),
        f'torque must be within {LIMITS} N m, got {largest.round(3).tolist()}',
    )
    ticks = np.maximum(np.round(np.diff(torques.stamp) * RATE), 1.0)[:, None]
    change = np.abs(np.diff(effort, axis=0))
    if not silent and len(change):
        outcome.require(
            (change <= DELTA * ticks * (1.0 + ROUNDING) + ROUNDING).all(),
            f'torque must change by at most {DELTA} N m per tick, got {change.max():.3f}',
        )
        pause = float(np.diff(torques.stamp).max())
        outcome.require(
            pause < LONGEST_PAUSE + torques.absent,
            f'torque must keep leaving, got a pause of {pause:.2f} s',
        )


def torque_text(torques: Torques, begin: float, end: float) -> str:
    """Say what the torque did from a fault's begin [s] to its end, and how soon it recovered."""
    following, stamp = torques.following, torques.stamp
    during = (stamp >= begin) & (stamp <= end)
    if not during.any():
        return 'silence'
    if following[during].all():
        return f'followed throughout ({int(during.sum())} messages)'
    gone = stamp[(stamp >= begin) & ~following]
    text = f'safe command after {1e3 * (gone[0] - begin):.0f} ms'
    back = stamp[(stamp > gone[0]) & following]
    if len(back) and back[0] <= end:
        return f'{text}, back after {1e3 * (back[0] - gone[0]):.0f} ms'
    if len(back):
        text += f', followed again {1e3 * (back[0] - end):.0f} ms after the end'
    return text


def markdown(outcomes: Sequence[Outcome]) -> str:
    """Return the table."""
    lines = [
        '| fault | what was sent | what the torque did | what /diagnostics said | what was lost |',
        '|---|---|---|---|---|',
    ]
    for row in outcomes:
        cells = [row.fault, row.sent, row.torque, row.diagnostics, row.lost]
        if row.broken:
            cells[2] += f'; **BROKEN: {"; ".join(row.broken)}**'
        lines.append('| ' + ' | '.join(cell.replace('|', '\\|') for cell in cells) + ' |')
    return '\n'.join(lines) + '\n'


def record(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Return the table as plain values, ready for JSON."""
    return [asdict(row) for row in outcomes]
