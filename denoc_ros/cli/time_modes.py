"""How a session's time goes: the words of the key `time`."""

from __future__ import annotations

REAL, SIMULATED, AUTO = TIMES = ('real', 'simulated', 'auto')
