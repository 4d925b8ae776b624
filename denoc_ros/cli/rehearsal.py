"""Choice between real and simulated time, by the cost of two seconds of a session."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from denoc_ros.cli.time_modes import REAL, SIMULATED

RATES = (1000.0, 500.0, 250.0)  # Hz at which loops may run in real time
SPARE = 2.0  # how many times over the machine must hold them
LATEST = 0.05  # share of deadlines that may be missed


@dataclass(frozen=True)
class Rehearsal:
    """The cost of a session in real time.

    Attributes
    ----------
    rates : mapping of str to float
        Rate of each loop [Hz].
    used, idle : float
        Cores that the nodes took, and that nobody took.
    cores : int
        That the session may use.
    late : float
        Largest share of its deadlines that a loop missed by more than half a period.
    lost : int
        Messages that the recorder lost.
    fixed : frozenset of str
        Loops whose rates the configuration says: gains and plans may need them.
    """

    rates: Mapping[str, float]
    used: float
    idle: float
    cores: int
    late: float
    lost: int
    fixed: frozenset[str] = frozenset()

    def at(self, rate: float) -> dict[str, float]:
        """Return the loops' rates where none is faster than a rate [Hz]."""
        return {
            name: given if name in self.fixed else min(given, rate)
            for name, given in self.rates.items()
        }

    def share(self, rate: float) -> float:
        """Return the cores that the nodes take where no loop is faster than a rate [Hz]."""
        return self.used * sum(self.at(rate).values()) / sum(self.rates.values())

    def holds(self, rate: float) -> bool:
        """Say whether the machine holds a rate [Hz] with as much to spare as it must have."""
        share, top = self.share(rate), max(self.rates.values())
        late = self.late * min(1.0, rate / top)
        lost = self.lost and rate >= top
        # what a slower session leaves may be taken by others: it does not count as idle
        return self.idle >= (SPARE - 1.0) * share and late <= LATEST and not lost


@dataclass(frozen=True)
class Choice:
    """The time that a session gets.

    Attributes
    ----------
    mode : str
        `real` or `simulated`.
    rates : mapping of str to float
        Rate of each loop [Hz].
    why : str
    """

    mode: str
    rates: Mapping[str, float]
    why: str


def choose(rehearsal: Rehearsal, refusal: Callable[[float], str] = lambda _rate: '') -> Choice:
    """Return the highest rates that the machine holds in real time, else simulated time.

    `refusal` tells why a rate [Hz] below the rehearsed ones may not be had, '' if it may.
    """
    top = max(rehearsal.rates.values())
    idle = f'{rehearsal.idle:.2f} of {rehearsal.cores} cores idle'
    machine = f'{idle} beside'
    free = rehearsal.rates.keys() - rehearsal.fixed
    for rate in [top, *(each for each in RATES if free and each < top)]:
        if not rehearsal.holds(rate):
            continue
        if rate < top and (refused := refusal(rate)):
            why = f'simulated time: {refused}; {top:g} Hz in real time are too much with {idle}'
            return Choice(SIMULATED, rehearsal.rates, why)
        cost = f'{machine} the {rehearsal.share(rate):.2f} that the nodes take'
        return Choice(REAL, rehearsal.at(rate), f'real time at {rate:g} Hz: {cost}')
    lowest = min(RATES) if free else top
    share = rehearsal.share(lowest)
    needs = SPARE * share / max(rehearsal.idle + share, 1e-3)
    if needs > 1.0:
        why = (
            f'with a factor of {SPARE:g} to spare this machine needs {needs:.1f} s for each second'
        )
    else:
        why = f'loops miss {100.0 * rehearsal.late:.0f} % of their deadlines on this machine'
    return Choice(
        SIMULATED,
        rehearsal.rates,
        f'simulated time: {why} ({machine} the {share:.2f} that the nodes take at {lowest:g} Hz)',
    )


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0))


def idle_seconds() -> float:
    """Return how long the cores that this process may use have been idle, all together [s]."""
    own = {f'cpu{core}' for core in os.sched_getaffinity(0)}
    ticks = 0
    for line in Path('/proc/stat').read_text().splitlines():
        name, *fields = line.split()
        if name in own:
            ticks += int(fields[3]) + int(fields[4])
    return ticks / os.sysconf('SC_CLK_TCK')
