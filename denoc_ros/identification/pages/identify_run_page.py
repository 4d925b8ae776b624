"""Page and text of `denoc identify RUN`: the numbers of a robot, and the modes of its decays."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from denoc_ros.identification.model.model_result import verdict_text
from denoc_ros.identification.pages.identify_numbers import channels_section, numbers_table
from denoc_ros.identification.pages.identify_result import (
    interval_text,
    number_cards,
    result_page,
    result_text,
)
from denoc_ros.pages.html_page import PageSection, PageTable, ReportPage

FOUND = 'found'


def run_text(document: Mapping[str, Any]) -> str:
    """Return the lines of a run's numbers for a terminal."""
    head: list[str] = []
    for plant in document['plants']:
        if line := _whose(plant, len(document['plants'])):
            head.append(line)
        head.append(numbers_table(plant['numbers'], _verdict).text())
        if plant['beams']:
            head += ['', _modes(plant).text()]
        head += [f'  {line}' for line in _notes(plant)]
        head.append('')
    return result_text(document, head[:-1], '', document['reasons'])


def run_page(document: Mapping[str, Any], command: str) -> ReportPage:
    """Return the page of a run's numbers."""
    plants = document['plants']
    needed = [one for plant in plants for one in plant['numbers'] if one['needed']]
    found = [one for one in needed if one['verdict'] == FOUND]
    sections: list[PageSection | None] = []
    for plant in plants:
        text = (
            'Found: known within 5 %. Doubtful: within 50 %, or the model does not explain the '
            'recording. SI units.'
        )
        tables = [
            numbers_table(plant['numbers'], _verdict),
            *([_modes(plant)] if plant['beams'] else []),
        ]
        whose = _whose(plant, len(plants)).rstrip(':')
        sentences = [_sentence(each) for each in (whose, text.rstrip('.'), *_notes(plant)) if each]
        sections.append(PageSection('Numbers', ' '.join(sentences), tables=tables))
        sections.append(channels_section(plant['channels']))
    said = f'{len(found)} of {len(needed)} numbers that a motion of this robot needs are found'
    return result_page(
        document, 'What the run says of the robot', said, number_cards(found), sections, command
    )


def _sentence(line: str) -> str:
    return f'{line[0].upper()}{line[1:]}.'


def _whose(plant: Mapping[str, Any], count: int) -> str:
    """Return of which phases some numbers are, '' where the run has no phases or one plant."""
    names = [name for name in plant['phases'] if name]
    if not names or (count == 1 and len(names) == 1):
        return f'phase {names[0]}:' if names else ''
    return f'phases {", ".join(names)}:'


def _verdict(one: Mapping[str, Any]) -> str:
    if one['needed'] or one['verdict'] == FOUND:
        return verdict_text(one)
    return f'{verdict_text(one)} (not needed)'


def _modes(plant: Mapping[str, Any]) -> PageTable:
    rows = [
        [
            one['link'],
            f'{one["frequency"]:.4g} Hz',
            f'{one["damping_ratio"]:.4g}',
            interval_text(one['interval']),
            str(one['decays']),
        ]
        for one in plant['beams']
    ]
    return PageTable(('beam', 'mode of free decays', 'damping ratio', '', 'decays'), rows)


def _notes(plant: Mapping[str, Any]) -> Iterator[str]:
    """Yield what is not determined, and why."""
    yield from plant['not_identifiable']
    names = _undetermined(plant['numbers'])
    if names:
        yield (
            f'not determined: {", ".join(names)}: the links swing too little; a free decay with '
            'the joints at rest tells damping'
        )
    doubtful = [one for one in plant['decays'] if one['verdict'] != 'good']
    if doubtful:
        yield f'{len(doubtful)} modes of decays are doubtful, such as: {doubtful[0]["reason"]}'


def _undetermined(numbers: Sequence[Mapping[str, Any]]) -> list[str]:
    return [
        one['path']
        for one in numbers
        if one['path'].endswith('.damping_ratio') and one['verdict'] == 'not identifiable'
    ]
