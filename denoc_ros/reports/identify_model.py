"""The page of `denoc identify model`: numbers, intervals, unidentifiable numbers, residuals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from denoc_ros.identification.model.result import verdict_text
from denoc_ros.reports.identify_result import interval_text, number_cards, result_page
from denoc_ros.reports.pages import PageSection, PageTable, ReportPage, engineering


def model_page(document: Mapping[str, Any], command: str) -> ReportPage:
    """Return the page of a model's numbers.

    Parameters
    ----------
    document : mapping
        The result, as in result.yaml.
    command : str
        The command line.
    """
    numbers = document['parameters']
    found = [one for one in numbers if one['verdict'] == 'found']
    cards = number_cards(found)
    sections = [_numbers(numbers), _combinations(document), _channels(document['channels'])]
    return result_page(
        document,
        'What the recordings say of the model',
        f'{len(found)} of {len(numbers)} numbers are found',
        cards,
        sections,
        command,
    )


def _numbers(numbers: Sequence[Mapping[str, Any]]) -> PageSection:
    rows = [
        [
            one['path'],
            f'{one["start"]:.5g}',
            f'{one["value"]:.5g}',
            interval_text(one['interval']),
            verdict_text(one),
        ]
        for one in numbers
    ]
    text = (
        'Found: known within 5 %. Doubtful: within 50 %, or the held-out part of a run is not '
        'explained as well as the rest. Of numbers that may have any sign, these are shares of '
        'what they add to; the table has half their interval. SI units.'
    )
    table = PageTable(['number', 'was', 'is', '', 'verdict'], rows)
    return PageSection('Numbers', text, tables=[table])


def _combinations(document: Mapping[str, Any]) -> PageSection | None:
    lines = [[line] for line in document['not_identifiable']]
    if not lines:
        return None
    text = 'What these data do tell of numbers that they do not tell one by one.'
    return PageSection('Not identifiable', text, tables=[PageTable([''], lines)])


def _channels(channels: Sequence[Mapping[str, Any]]) -> PageSection:
    keys = ('rms_before', 'rms_after', 'held_out_before', 'held_out_after')
    rows = [
        [
            one['run'],
            one['channel'],
            *('' if one[key] is None else engineering(one[key], one['unit']) for key in keys),
        ]
        for one in channels
    ]
    head = ['run', 'channel', 'before', 'after', 'held out: before', 'after']
    text = (
        'rms of measured minus predicted. Held out is the last part of each run, which a first '
        'fit did not see.'
    )
    return PageSection('Channels', text, tables=[PageTable(head, rows)])
