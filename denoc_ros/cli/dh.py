"""`denoc dh`: a Denavit-Hartenberg table to URDF + `<flexibility>`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from denoc_ros.cli.verbs import VERBS
from denoc_ros.model.dh.system import load_system
from denoc_ros.model.dh.urdf import urdf_text
from denoc_ros.model.urdf import load_tree
from denoc_ros.output_files import write_new


def add_parser(subparsers: Any) -> None:
    """Add the verb to the parsers of `denoc`."""
    parser: argparse.ArgumentParser = subparsers.add_parser('dh', help=VERBS['dh'])
    parser.add_argument('table', help='YAML file with one system, or with several by name')
    parser.add_argument('-o', '--output', required=True, help='the URDF to write, a new file')
    parser.add_argument('--system', help='name of the system, for a file with several')
    parser.add_argument(
        '--kinds',
        help='R (rigid) or F (flexible) for each link, such as FFR; default: as in the table',
    )


def run(args: argparse.Namespace) -> int:
    """Write the URDF of a table.

    Parameters
    ----------
    args : argparse.Namespace
        `table`, `output`, `system`, `kinds`.

    Returns
    -------
    int
        0; what is wrong is raised.

    Raises
    ------
    ConfigError
        With every finding of the table, or if the output exists or cannot be written.
    ModelError
        If the table's robot is not possible.
    """
    system = load_system(args.table, args.system, args.kinds)
    text = urdf_text(system)
    tree = load_tree(text)
    write_new(Path(args.output), text)
    flexible = sum(body.beam is not None and body.segment == 1 for body in tree.bodies)
    print(f'{args.output}: {len(system.links)} links, {flexible} flexible')
    return 0
