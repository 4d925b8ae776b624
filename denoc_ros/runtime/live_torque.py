"""The torque of a live model, which may change, fail and be reset."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from denoc_ros.dynamics.equilibrium import UnsettledError
from denoc_ros.dynamics.feedforward import Terms, TorqueFeedforward
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError, StateError
from denoc_ros.runtime.parameters import Settings
from denoc_ros.runtime.rate_limiter import Backoff
from denoc_ros.types import Array

SUBSTEPS = 20  # of the model in one tick after a pause
SEARCH_SHARE = 0.5  # of a period that a tick may search for an equilibrium
FAILING_SHARE = 0.1  # of a processor for a model that fails
LONGEST_WAIT = 0.25  # s until it is tried again


def torque_feedforward(
    robot: Robot, joints: Sequence[str], settings: Settings, posture: Array, in_loop: bool
) -> TorqueFeedforward:
    """Return the torque that a node's parameters ask for, each of its verbs called once.

    Parameters
    ----------
    robot : Robot
    joints : sequence of str
        That are driven.
    settings : Settings
    posture : (n,) array
        Near which loops are closed.
    in_loop : bool
        Whether a loop waits for it, which has no time for more than a little work per tick.
    """
    terms = Terms(**{name: settings.flag(f'terms.{name}') for name in Terms.names()})
    period = 1.0 / settings.number('update_rate')
    source = TorqueFeedforward(
        robot, joints, settings.text('model'), terms, period, posture=posture
    )
    zero, there = np.zeros(len(joints)), source.q[source.motion.index]
    source.update(there, zero, zero, 0.0)
    source.update(there, zero, zero, period)
    source.gravity(there)
    source.reset()
    if in_loop:
        source.substeps, source.patience = SUBSTEPS, SEARCH_SHARE * period
    return source


class LiveTorque:
    """Torque along a motion by a model that may be replaced between two ticks.

    Parameters
    ----------
    source : TorqueFeedforward
    in_loop : bool
        Whether a model that fails is left alone for a while, so that the loop keeps its period.

    Attributes
    ----------
    source : TorqueFeedforward
        The model's at present.
    failures : int
        How often it gave no torque.
    """

    def __init__(self, source: TorqueFeedforward, in_loop: bool) -> None:
        self.source = source
        self.failures = 0
        self._backoff = Backoff(FAILING_SHARE, LONGEST_WAIT) if in_loop else None

    def replace(self, source: TorqueFeedforward) -> None:
        """Go on with another model where the one before is."""
        source.adopt(self.source)
        self.source = source

    def reset(self) -> None:
        """Forget the amplitudes."""
        self.source.reset()

    def update(self, q: Array, qd: Array, qdd: Array, elapsed: float) -> Array | None:
        """Return the torque (n,) of a motion, None while the model fails; as the source's."""
        backoff, now = self._backoff, time.perf_counter()
        if backoff is not None and not backoff.due(now):
            return None
        begin = time.thread_time()
        try:
            return self.source.update(q, qd, qdd, elapsed)
        except UnsettledError:  # the next update goes on with it
            return None
        except (StateError, SolverError):
            self.failures += 1
            self.source.reset()
            if backoff is not None:
                backoff.failed(now, time.thread_time() - begin)
            return None
