"""Output that the actions of `denoc identify` share: files, page, text or JSON."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping
from typing import Any

from denoc_ros.cli.exit_statuses import exit_status
from denoc_ros.identification.result import RESULT_FILE, write_result
from denoc_ros.output_files import write_text
from denoc_ros.reports.pages import ReportPage


def give_result(
    args: argparse.Namespace,
    document: Mapping[str, Any],
    text: str,
    page: Callable[[], ReportPage],
) -> int:
    """Write a result and its page if requested, print it, return its exit status."""
    if args.output:
        if (args.output / RESULT_FILE).exists():
            print(
                f'denoc identify: {args.output}: the earlier result is replaced', file=sys.stderr
            )
        write_result(args.output, document)
        write_text(args.output / 'report.html', page().html())
    print(json.dumps(document, indent=2) if args.json else text)
    return exit_status(document['verdict'])
