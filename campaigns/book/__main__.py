"""`python -m book STUDY [options]`: bench, stability or selftest."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module

from denoc_ros.cli.main import Parser, run_command


def main(argv: Sequence[str] | None = None) -> int:
    """Run a study as `denoc` runs a verb; return its exit status."""
    study, *options = sys.argv[1:] if argv is None else argv
    name = f'python -m campaigns {study}'

    def build(_: list[str]) -> Parser:
        module = import_module(f'book.{study}')
        parser = Parser(prog=name, description=module.DESCRIPTION)
        module.add_options(parser)
        parser.set_defaults(execute=module.run)
        return parser

    return run_command(name, build, options, is_process=argv is None)


if __name__ == '__main__':
    sys.exit(main())
