"""What the gauges of a siege's robot say, and what may go wrong with them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from sensor_msgs.msg import JointState
from trust.stage import stamp

FEEDBACK = 'feedforward: state feedback'  # status on /diagnostics
DEAD = ('silent', 'one silent', 'wild')  # none of these may be fed back
# one gauge says something else than strain: none of these may let an estimate out of its bounds
SPOILT = ('offset', 'drift', 'noise', 'full scale', 'unit')
# late: all values by a constant time; jumpy: each by another one, up to 50 ms
FAULTS = (*DEAD, 'late', 'jumpy', 'lost', *SPOILT)
LATE = 200_000_000  # ns
JUMP = 50_000_000  # ns
LOST = 0.3  # share of the values
NOISE = 1e-5  # strain, as the robot's file says of most of its gauges
OFFSET, FULL_SCALE = 50.0 * NOISE, 3e-3  # strain
DRIFT = 100.0 * NOISE  # strain per second
MICROSTRAIN = 1e6


class Gauges:
    """Strain gauges of a robot at rest, without gravity.

    Parameters
    ----------
    names : sequence of str
        Of the gauges; without any nothing is said.

    Attributes
    ----------
    fault : str
        One of FAULTS, '' while they are good.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._names = list(names)
        self._generator = np.random.default_rng(0)
        self.fault = ''
        self._since_ns = 0  # of the fault

    def message(self, now_ns: int) -> JointState:
        """Return what good gauges say."""
        message = JointState(name=self._names, position=[0.0] * len(self._names))
        stamp(message, now_ns)
        return message

    def messages(self, now_ns: int) -> list[JointState]:
        """Return what they say now."""
        fault, draw = self.fault, self._generator.random()
        self._since_ns = (self._since_ns or now_ns) if fault else 0
        if not self._names or fault == 'silent' or (fault == 'lost' and draw < LOST):
            return []
        message = self.message(now_ns)
        if fault == 'one silent':
            message.name, message.position = self._names[1:], message.position[1:]
        elif fault == 'wild':
            message.position = [float('nan') if draw < 0.5 else 1e3] * len(self._names)
        elif fault in SPOILT:
            message.position[-1] = self._spoilt(fault, 1e-9 * (now_ns - self._since_ns))
        elif fault == 'late':
            stamp(message, now_ns - LATE)
        elif fault == 'jumpy':
            stamp(message, now_ns - round(JUMP * draw))
        return [message]

    def _spoilt(self, fault: str, since: float) -> float:
        """Return what a spoilt gauge says some time after its fault began [s]."""
        noise = NOISE * float(self._generator.standard_normal())
        return {
            'offset': OFFSET,
            'drift': DRIFT * since,
            'noise': 100.0 * noise,
            'full scale': FULL_SCALE,
            'unit': MICROSTRAIN * noise,
        }[fault]
