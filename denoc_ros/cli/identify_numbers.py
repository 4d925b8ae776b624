"""The table of a robot's numbers that the actions of `denoc identify` print."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from denoc_ros.identification.model.result import verdict_text
from denoc_ros.reports.text_table import text_table


def numbers_text(parameters: Sequence[Mapping[str, Any]], verdict: str) -> str:
    """Return the lines of numbers with their intervals and verdicts.

    Parameters
    ----------
    parameters : sequence of mappings
        Path, value, interval and verdict of each; `start` where it has been another.
    verdict : str
        What the verdict is called.
    """
    return text_table(
        [
            {
                'number': one['path'],
                **({'was': one['start']} if 'start' in one else {}),
                'is': one['value'],
                '95 % from': one['interval'][0],
                'to': one['interval'][1],
                verdict: verdict_text(one),
            }
            for one in parameters
        ]
    )
