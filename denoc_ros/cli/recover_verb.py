"""`denoc recover`: a complete bag from a truncated recording."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from tqdm import tqdm

from denoc_ros.bags.recover import recover
from denoc_ros.cli.arguments import add_json, add_option, add_output
from denoc_ros.cli.verb_result import VerbResult
from denoc_ros.cli.verbs import DOUBTFUL
from denoc_ros.terminal_text import visible_cell

DESCRIPTION = (
    'Rebuild an MCAP bag from its complete records, without changing the original. Exit status '
    '2 if parts within it were damaged, or are no MCAP.'
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_option(parser, 'bag', 'a .mcap file or a folder of them', type=Path)
    text = 'new bag folder, or new .mcap for a single file (default: BAG_recovered)'
    add_output(parser, '', text)
    add_json(parser)


def run(args: argparse.Namespace) -> VerbResult:
    """Recover; exit status 2 where parts were damaged or left out."""
    with tqdm(unit='B', unit_scale=True, disable=True if args.json else None, leave=False) as bar:
        result = recover(args.bag, args.output, bar.update)
    row = {
        'path': str(result.path),
        'messages': result.messages,
        'topics': result.counts,
        'files': [part.name for part in result.files],
        'torn': list(result.torn),
        'damaged_chunks': result.damaged_chunks,
        'left_out': list(result.left_out),
        'unknown_messages': result.unknown_messages,
    }
    doubtful = result.damaged_chunks or result.left_out or result.unknown_messages
    return VerbResult(row, _lines(row), DOUBTFUL if doubtful else 0)


def _lines(row: dict[str, Any]) -> list[str]:
    files = len(row['files'])
    lines = [f'{row["path"]}: {row["messages"]} messages in {files} file{"s" * (files != 1)}']
    lines += [
        f'  {visible_cell(topic)}: {count}' for topic, count in sorted(row['topics'].items())
    ]
    lines += [f'  {visible_cell(name)} was cut off or damaged' for name in row['torn']]
    lines += [
        f'  {visible_cell(name)} was left out: it is no MCAP file' for name in row['left_out']
    ]
    if row['damaged_chunks']:
        lines.append(f'  {row["damaged_chunks"]} damaged chunks were left out')
    if row['unknown_messages']:
        count = row['unknown_messages']
        lines.append(f'  {count} messages were left out: the file does not say of which topic')
    return lines
