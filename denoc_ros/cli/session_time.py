"""The time of a session: real, or simulated by the plant in lockstep with the other nodes."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING

from denoc_ros.errors import DenocError

if TYPE_CHECKING:  # an optional extra
    from denoc_ros.nodes.session_client import SessionClient

STANDS = 120.0  # s of wall time in which simulated time must go on, on the slowest machine
SAME = 1e-6  # s


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
    client : SessionClient
        It hears /clock.
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
        while (now_ns := self._client.clock_ns()) < end_ns:
            if now_ns != last:
                last, moved = now_ns, time.perf_counter()
            elif time.perf_counter() - moved > STANDS:
                said = self._client.diagnostics('plant: clock').get('', 'nothing')
                raise DenocError(
                    f'plant: simulated time must go on to {1e-9 * end_ns:.3f} s, it stands at '
                    f'{1e-9 * last:.3f} s for {STANDS:g} s; plant: clock says {said}'
                )
            show(1e-9 * max(now_ns, 0))
            self._client.wait(0.02)
        show(1e-9 * end_ns)

    def settle(self, is_so: Callable[[], bool], patience: float) -> None:
        """Wait until the nodes have taken their messages: time may go on then."""
        self._client.until(is_so, patience)
