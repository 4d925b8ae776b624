"""`python -m denoc_ros.cli.player`: plays a bag's joint states in real time.

Sessions and launch files start it.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from denoc_ros.cli.arguments import add_option
from denoc_ros.runtime.loop.ending import SIGNALS


def speed(text: str) -> float:
    """Return how many times as fast as real time a recording is played.

    Raises
    ------
    argparse.ArgumentTypeError
        It is no finite number > 0.
    """
    with suppress(ValueError):
        value = float(text)
        if 0.0 < value < math.inf:
            return value
    raise argparse.ArgumentTypeError(f'speed must be a number > 0, got {text!r}')


def main(arguments: Sequence[str] | None = None) -> int:
    """Play a bag as a process; return the exit status."""
    from denoc_ros.nodes import bag_player as player

    given = list(sys.argv[1:] if arguments is None else arguments)
    parser = argparse.ArgumentParser(prog='denoc_ros.cli.player', description=player.__doc__)
    parser.add_argument('bag', type=Path)
    parser.add_argument('--topic', default='/joint_states')
    parser.add_argument('--speed', type=speed, default=1.0, help='> 0; 1 for real time')
    add_option(parser, '--listeners', 'nodes to wait for', [], nargs='*')
    add_option(
        parser,
        '--clock',
        'play all topics that nobody publishes, and /clock by the recorded stamps; each '
        'step waits for the listeners',
    )
    options = parser.parse_args(player.own_arguments(given))
    return player.run(
        options.bag, options.topic, options.speed, options.listeners, given, options.clock
    )


if __name__ == '__main__':
    SIGNALS.end_at_once()  # until the node is there
    status = main()
    from denoc_ros.nodes.base.process import leave

    leave(status)
