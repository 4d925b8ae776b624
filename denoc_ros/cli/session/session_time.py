"""The time of a session: real, or simulated by the plant in lockstep with the other nodes."""

from __future__ import annotations

import math
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from denoc_ros.cli.session.node_parameters import node_parameters, node_table
from denoc_ros.cli.session.session_config import REAL, SIMULATED, Parameters, Phase, SessionConfig
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError, DenocError, SolverError, StateError
from denoc_ros.runtime.feedback_law import feedback_law
from denoc_ros.runtime.safety.torque import torque_limits

if TYPE_CHECKING:
    from denoc_ros.nodes.session_client import SessionClient

STANDS = 120.0  # s of wall time in which simulated time must go on, on the slowest machine
# s for which /clock may have another publisher than the plant, such as a plant that was killed
DISPUTED_TIME_S = 30.0
SAME = 1e-6  # s
RATES = (1000.0, 500.0, 250.0)  # Hz at which loops may run in real time
SPARE = 2.0  # how many times over the machine must hold them
SPARE_ALONE = 3.0  # the same on one core, where loops wait for each other and for whoever comes
LATEST = 0.02  # share of deadlines that may be missed
FEEDFORWARD = 'feedforward'
PATIENCE = 60.0  # s for the gains of a phase


class SessionTime(ABC):
    """The robot's time, for a session's waits and stamps."""

    is_simulated = False

    @abstractmethod
    def now(self) -> float:
        """Return the present moment [s]."""

    @abstractmethod
    def stamp_ns(self, moment: float) -> int:
        """Return the stamp [ns] of a moment [s]."""

    @abstractmethod
    def go_to(self, moment: float, show: Callable[[float], None] = lambda _now: None) -> None:
        """Let time pass up to a moment [s]; `show` is told the time about every 0.1 s."""

    def pass_by(self, seconds: float) -> None:
        """Let some time pass [s]."""
        self.go_to(self.now() + seconds)

    @abstractmethod
    def settle(self, is_so: Callable[[], bool], patience: float) -> None:
        """Wait, where time stands, until nodes have taken their messages [s of wall time]."""


class RealTime(SessionTime):
    """Wall time."""

    def __init__(self, client: SessionClient) -> None:
        self._client = client

    def now(self) -> float:
        """Return the steady clock's time [s]."""
        return time.perf_counter()

    def stamp_ns(self, moment: float) -> int:
        """Return the stamp of the system's clock [ns] at a moment [s]."""
        return time.time_ns() + round(1e9 * (moment - time.perf_counter()))

    def go_to(self, moment: float, show: Callable[[float], None] = lambda _now: None) -> None:
        """Wait until a moment [s]."""
        while (left := moment - time.perf_counter()) > 0.0:
            show(time.perf_counter())
            self._client.wait(min(0.1, left))

    def settle(self, is_so: Callable[[], bool], patience: float) -> None:
        """Return at once: messages sent long before they count arrive in time."""


class SimulatedTime(SessionTime):
    """The time that the plant makes: between two waits it stands, at an exact moment.

    Parameters
    ----------
    period : float
        Of the plant [s]: time stands at multiples of it.
    """

    is_simulated = True

    def __init__(self, client: SessionClient, period: float) -> None:
        self._client, self._period = client, period
        self._stands = 0.0

    def now(self) -> float:
        """Return the moment at which time stands [s]."""
        return self._stands

    def stamp_ns(self, moment: float) -> int:
        """Return the stamp [ns] of a moment [s]."""
        return round(1e9 * moment)

    def go_to(self, moment: float, show: Callable[[float], None] = lambda _now: None) -> None:
        """Let time go on to the first of the plant's steps at a moment [s] or later."""
        count = math.ceil(moment / self._period - SAME)
        end = round(1e9 * count * self._period)
        if end <= round(1e9 * self._stands):
            return
        # half a step later: the plant stands where its next step would be beyond it
        self._client.set_parameters('plant', {'pause_at': (count + 0.5) * self._period})
        self._await(end, show)
        self._stands = 1e-9 * end

    def _await(self, end_ns: int, show: Callable[[float], None]) -> None:
        last, moved = -1, time.perf_counter()
        while last < end_ns:
            # Of several publishers the newest time need not be the plant's.
            publishers = self._client.clock_publishers()
            now_ns = self._client.clock_ns() if publishers == 1 else last
            stood = time.perf_counter() - moved
            if now_ns > last:
                last, moved = now_ns, time.perf_counter()
            elif stood > (DISPUTED_TIME_S if publishers > 1 else STANDS):
                raise DenocError(
                    f'/clock: simulated time must go on to {1e-9 * end_ns:.3f} s, got one that '
                    f'stands at {1e-9 * max(last, 0):.3f} s for {stood:.0f} s, of {publishers} '
                    f'publishers (one must be there); {self._client.reported("clock")}'
                )
            show(1e-9 * max(last, 0))
            self._client.wait(0.02)
        show(1e-9 * end_ns)

    def settle(self, is_so: Callable[[], bool], patience: float) -> None:
        """Wait until the nodes have taken their messages: time may go on then."""
        self._client.until(is_so, patience)


@dataclass(frozen=True)
class Rehearsal:
    """The cost of a session in real time."""

    rates: Mapping[str, float]  # rate of each loop [Hz]
    # cores that the nodes took, and that nobody took
    used: float
    idle: float
    cores: int  # that the session may use
    late: float  # largest share of its deadlines that a loop missed by more than half a period
    lost: int  # messages that the recorder lost
    # loops whose rates the configuration says: gains and plans may need them
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

    @property
    def spare(self) -> float:
        """How many times over the machine must hold the nodes."""
        return SPARE if self.cores > 1 else SPARE_ALONE

    def holds(self, rate: float) -> bool:
        """Say whether the machine holds a rate [Hz] with as much to spare as it must have."""
        share, top = self.share(rate), max(self.rates.values())
        late = self.late * min(1.0, rate / top)
        lost = self.lost and rate >= top
        # what a slower session leaves may be taken by others: it does not count as idle
        return self.idle >= (self.spare - 1.0) * share and late <= LATEST and not lost


@dataclass(frozen=True)
class Choice:
    """The time that a session gets."""

    mode: str  # `real` or `simulated`
    rates: Mapping[str, float]  # rate of each loop [Hz]
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
    needs = rehearsal.spare * share / max(rehearsal.idle + share, 1e-3)
    if needs > 1.0:
        spare = f'with a factor of {rehearsal.spare:g} to spare'
        why = f'{spare} this machine needs {needs:.1f} s for each second'
    else:
        why = f'loops miss {100.0 * rehearsal.late:.0f} % of their deadlines on this machine'
    return Choice(
        SIMULATED,
        rehearsal.rates,
        f'simulated time: {why} ({machine} the {share:.2f} that the nodes take at {lowest:g} Hz)',
    )


def idle_seconds() -> float:
    """Return how long the cores that this process may use have been idle, all together [s]."""
    own = {f'cpu{core}' for core in os.sched_getaffinity(0)}
    ticks = 0
    for line in Path('/proc/stat').read_text().splitlines():
        name, *fields = line.split()
        if name in own:
            ticks += int(fields[3]) + int(fields[4])
    return ticks / os.sysconf('SC_CLK_TCK')


def feedback_refusal(
    config: SessionConfig, robot: Robot, rate: float, patience: float = PATIENCE
) -> str:
    """Why a phase's feedback cannot run at a rate, by the design's own check; '' if all can.

    Parameters
    ----------
    config : SessionConfig
        Its phases may each have another feedback.
    rate : float
        Of the feedforward's loop [Hz].
    patience : float
        For the gains of a phase [s].
    """
    model = robot.with_overrides(config.model)
    shown: list[Parameters] = []
    for phase in config.phases:
        given = _given(config, phase, rate)
        if given in shown:
            continue
        if trouble := _trouble(model, given, patience):
            return f'feedback of phase “{phase.name}” does not hold at {rate:g} Hz: {trouble}'
        shown.append(given)
    return ''


def _given(config: SessionConfig, phase: Phase, rate: float) -> Parameters:
    given = node_parameters(config, FEEDFORWARD, phase, Path())
    given.pop('use_sim_time', None)
    if 'update_rate' not in phase.nodes.get(FEEDFORWARD, {}):
        given['update_rate'] = rate
    return given


def _trouble(robot: Robot, given: Parameters, patience: float) -> str:
    """Why the feedback of these parameters is refused, '' if it is not."""
    settings = node_table(FEEDFORWARD).settings(given, FEEDFORWARD)
    joints = settings.texts('joints') or list(robot.tree.non_mimic_joints)
    posture = np.zeros(robot.n)
    posture[robot.joint_indices] = settings.numbers('posture') or 0.0
    law = feedback_law(FEEDFORWARD)
    try:
        limits = torque_limits(robot, joints, settings)
        law.build(robot, joints, settings, limits, posture, patience)
        return f'no gains within {patience:g} s' if law.busy else ''
    except ConfigError as error:
        return '; '.join(error.findings)
    except (StateError, SolverError, ValueError) as error:
        return str(error)
    finally:
        law.close()
