"""Recent states of an observer, to go back to before wrong measurements."""

from __future__ import annotations

from collections import deque

from denoc_ros.estimation.observer import MeasuredState, Observer

STEP_S = 0.01  # Time between two states.
STATES = 64


class ObserverHistory:
    """States of an observer at its measurements of the last moments."""

    def __init__(self) -> None:
        self._states: deque[MeasuredState] = deque(maxlen=STATES)

    def clear(self) -> None:
        """Forget all states."""
        self._states.clear()

    def add(self, observer: Observer) -> None:
        """Keep the observer's state at its last measurement, one for each `STEP_S`."""
        states, stamp = self._states, observer.stamp
        if states and not stamp - states[-1].stamp >= STEP_S:
            return
        state = observer.measured_state()
        if state is not None:
            states.append(state)

    def rewind(self, observer: Observer, time: float) -> bool:
        """Bring an observer back to just before a time [s]; False if no state is from there."""
        states = self._states
        while states and not states[-1].stamp < time:
            states.pop()
        if not states or time - states[-1].stamp > 2.0 * STEP_S:
            states.clear()
            return False
        observer.rewind(states[-1])
        return True
