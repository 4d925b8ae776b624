"""A bare sleeping thread: a loop that does nothing, for the lateness that the machine has.

`python -m bench.loops.sleeper RATE PRIORITY`: SIGUSR1 begins, SIGUSR2 pauses, SIGINT ends.
"""

from __future__ import annotations

import gc
import signal
import sys
import time

from denoc_ros.runtime.loop.realtime_loop import RealtimeLoop


def main() -> None:
    rate, priority = float(sys.argv[1]), int(sys.argv[2])
    told: list[int] = []
    for number in (signal.SIGUSR1, signal.SIGUSR2, signal.SIGINT):
        signal.signal(number, lambda got, _: told.append(got))
    gc.freeze()
    gc.disable()
    loop = RealtimeLoop(rate, lambda steps: None, priority)
    while True:
        while told:
            told_now = told.pop(0)
            loop.stop()
            if told_now == signal.SIGINT:
                return
            if told_now == signal.SIGUSR1:
                loop = RealtimeLoop(rate, lambda steps: None, priority)
                loop.start()
        time.sleep(0.02)


if __name__ == '__main__':
    main()
