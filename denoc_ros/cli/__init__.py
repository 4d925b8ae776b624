"""The command `denoc`: one file per verb."""

import os
import signal
import sys

from denoc_ros.cli.verbs import INTERRUPTED


def end_at_once(_number: int, _frame: object) -> None:
    """Handle Ctrl-C before the command has begun: there is nothing yet to be ended."""
    os.write(2, b'denoc: interrupted\n')
    os._exit(INTERRUPTED)


# before the imports of the command, which take a while on a busy machine
if os.path.basename(sys.argv[0] if sys.argv else '') == 'denoc' and (
    signal.getsignal(signal.SIGINT) is signal.default_int_handler
):
    signal.signal(signal.SIGINT, end_at_once)
