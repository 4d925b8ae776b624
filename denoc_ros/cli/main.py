"""The command `denoc VERB`: collects the verbs, runs one, turns errors into an exit status."""

from __future__ import annotations

import argparse
import gc
import importlib
import io
import logging
import os
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any, NoReturn

from denoc_ros.cli import end_at_once
from denoc_ros.cli.interrupts import interrupt, is_made_by_interrupt, noted_interrupts
from denoc_ros.cli.verbs import BAD_INPUT, CAMPAIGNS, INTERRUPTED, verbs
from denoc_ros.errors import ConfigError, DenocError
from denoc_ros.terminal_text import say

# objects after which garbage is looked for: with 700 that takes a seventh of a start
GARBAGE = 20_000
# small solutions by the thousand: threads wait for each other, on a busy machine for most of the
# time; read when numpy is first imported
ONE_THREAD = 'OPENBLAS_NUM_THREADS', '1'
LONGEST = 2000  # characters of a line of a message
_MEMORY = 'memory must be enough for what was asked, got: {}'
# of libraries; the last two are an extension's that could not make an exception either
_NO_MEMORY = (
    *('failed to map segment', 'Cannot allocate memory', 'cannot allocate memory'),
    *('without exception set', 'without setting an exception'),
)


class Parser(argparse.ArgumentParser):
    """An argument parser whose usage errors exit with status 1 (2 is a doubtful result).

    Its arguments have `findings`, to which options add what is wrong with their values.
    """

    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        self.set_defaults(findings=[])

    def _print_message(self, message: str, file: Any = None) -> None:
        if message:
            say(message, end='', file=file or sys.stderr)

    def error(self, message: str) -> NoReturn:
        """Print the usage and the message on stderr and exit with status 1."""
        self.print_usage(sys.stderr)
        self.exit(BAD_INPUT, f'{self.prog}: {message}\n')


class Version(argparse.Action):
    """`--version`: looked up only when asked for, since importlib.metadata is slow to import."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        """Print the package's version, its commit where known, and where its pages are."""
        from importlib.metadata import version

        from denoc_ros.cli.session.session_config import share_directory
        from denoc_ros.versions import source_commit

        commit = source_commit(Path(__file__).resolve().parents[1])
        say(f'denoc_ros {version("denoc_ros")}' + (f' (commit {commit})' if commit else ''))
        pages = share_directory() / 'README.md'
        if pages.is_file():
            say(f'documentation: {pages}')
        parser.exit()


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb of the command line; return its exit status."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    name = f'denoc {" ".join(arguments[:1])}'
    return run_command(name, build_parser, completed(arguments), is_process=argv is None)


def run_command(
    name: str, build: Callable[[list[str]], Parser], arguments: list[str], is_process: bool
) -> int:
    """Run a command: its errors are messages, its result is shown.

    Parameters
    ----------
    name : str
        What messages begin with.
    build : callable
        Returns the parser of the arguments, whose `execute` runs the command.
    is_process : bool
        Whether this process runs nothing else.

    Returns
    -------
    int
        0 good, 1 bad input (message on stderr), 2 doubtful result, 3 not identifiable,
        130 interrupted.
    """
    if is_process:
        gc.set_threshold(GARBAGE)
        os.environ.setdefault(*ONE_THREAD)
        if signal.getsignal(signal.SIGINT) in (signal.default_int_handler, end_at_once):
            signal.signal(signal.SIGINT, interrupt)
    try:
        if is_process:
            _require_streams()
        status = _execute(name, build, arguments, is_process)
    except BaseException as error:
        if not (isinstance(error, KeyboardInterrupt) or is_made_by_interrupt(error)):
            raise
        _ignore_interrupts(is_process)
        say(f'{name}: interrupted', file=sys.stderr)
        if is_process:
            _leave_compiler()
        return INTERRUPTED
    _ignore_interrupts(is_process)
    return status


def _execute(
    name: str, build: Callable[[list[str]], Parser], arguments: list[str], is_process: bool
) -> int:
    """Run the command; errors are messages."""
    try:
        with noted_interrupts() if is_process else nullcontext():
            parser = build(arguments)
        args = parser.parse_args(arguments)
        ConfigError.raise_any('command line', args.findings)
        from denoc_ros.pages.provenance import command_line

        args.command = command_line(arguments, parser.prog)
        args.is_process = is_process
        _show_log()
        found = args.execute(args)
        status = found if isinstance(found, int) else found.show(args.json)
        sys.stdout.flush()
    except SystemExit as stop:
        _flush_or_discard()  # of --help
        return int(stop.code or 0)
    except DenocError as error:
        return _complain(name, str(error))
    except BrokenPipeError:
        _discard_output()
        return 0
    except FileExistsError as error:
        return _complain(name, f'{error.filename}: output must not exist yet, got an existing one')
    except OSError as error:
        status = _complain(name, f'{error.filename or "output"}: {error.strerror or error}')
        _flush_or_discard()
    except MemoryError as error:
        status = _complain(name, _MEMORY.format(str(error).strip() or 'too little'))
    except (ImportError, SystemError) as error:
        if is_made_by_interrupt(error) or not any(word in str(error) for word in _NO_MEMORY):
            raise
        status = _complain(name, _MEMORY.format(error))
    return status


def build_parser(arguments: Sequence[str] = ()) -> Parser:
    """Return the parser of the verb that the arguments start with, else the list of verbs."""
    parser = Parser(
        prog='denoc',
        description='Real-time model-based control of robots with flexible links (DeNOC).',
    )
    parser.add_argument('--version', action=Version, nargs=0, help='print the version and exit')
    subparsers = parser.add_subparsers(dest='verb', metavar='VERB', required=True)
    for words, campaign in CAMPAIGNS.items():
        if ' '.join(arguments[: 1 + words.count(' ')]) == words:
            raise DenocError(
                f'{words} is a campaign: run python -m campaigns {campaign} in a checkout'
            )
    known = verbs()
    if not arguments or arguments[0] not in known:
        for name, row in known.items():
            subparsers.add_parser(name, help=row.help)
        return parser
    verb = arguments[0]
    module = importlib.import_module(f'denoc_ros.{known[verb].module}')
    named = subparsers.add_parser(verb, help=known[verb].help, description=module.DESCRIPTION)
    if known[verb].actions:
        module.add_actions(named, arguments[1] if len(arguments) > 1 else '')
    else:
        module.add_options(named)
    named.set_defaults(execute=module.run)
    return parser


def completed(arguments: list[str]) -> list[str]:
    """Put the default action in where a verb that has actions is given none."""
    row = verbs().get(arguments[0]) if len(arguments) > 1 else None
    if row is None or not row.actions or arguments[1].startswith('-'):
        return arguments
    known = importlib.import_module(f'denoc_ros.{row.actions}')
    is_action = ' '.join(arguments[:2]) in CAMPAIGNS or arguments[1] in known.ACTIONS
    if is_action:
        return arguments
    return [arguments[0], known.default_action(arguments[1:]), *arguments[1:]]


class _StderrHandler(logging.Handler):
    """Prints records on the stderr of the moment: a process may run several commands."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record."""
        say(self.format(record), file=sys.stderr)


def _show_log() -> None:
    """Send the package's log, such as the compilation of its kernels, to stderr."""
    log = logging.getLogger('denoc_ros')
    if not log.handlers:
        handler = _StderrHandler()
        handler.setFormatter(logging.Formatter('denoc: %(message)s'))
        log.addHandler(handler)
    log.setLevel(logging.INFO)


def _leave_compiler() -> None:
    """End now if a kernel is being compiled, for which the interpreter would wait."""
    compiling = sys.modules.get('denoc_ros.kernels.jit.compiling')
    if compiling is not None and compiling.at_work():
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(INTERRUPTED)


def _complain(name: str, message: str) -> int:
    lines = [line for line in message.splitlines() if line.strip()]
    for line in lines or ['an error without words']:
        more = f'… ({len(line) - LONGEST} characters more)' if len(line) > LONGEST else ''
        say(f'{name}: {line[:LONGEST]}{more}', file=sys.stderr)
    return BAD_INPUT


def _require_streams() -> None:
    """Have stdout and stderr, whatever the process was started with.

    A closed one would have its number given to the next file that is opened, and printed into. A
    terminal whose encoding lacks a character gets its code.
    """
    for name, number in (('stdout', 1), ('stderr', 2)):
        if getattr(sys, name) is None:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            if nowhere != number:
                os.dup2(nowhere, number)
            setattr(sys, name, os.fdopen(number, 'w', encoding='utf-8', closefd=False))
        elif isinstance(stream := getattr(sys, name), io.TextIOWrapper):
            stream.reconfigure(errors='backslashreplace')


def _ignore_interrupts(is_process: bool) -> None:
    """Ignore Ctrl-C on a process's last way: it is not to change the status."""
    if is_process:
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _flush_or_discard() -> None:
    try:
        sys.stdout.flush()
    except OSError:
        _discard_output()


def _discard_output() -> None:
    """Discard the interpreter's last flush: the reader of our output has gone."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == '__main__':
    sys.exit(main())
