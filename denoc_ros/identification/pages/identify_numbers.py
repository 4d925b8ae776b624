"""Pages and texts of `denoc identify model` and `excite`: a robot's numbers and intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from denoc_ros.identification.model.excitation import Excitation
from denoc_ros.identification.model.model_result import verdict_text
from denoc_ros.identification.pages.identify_result import (
    TONES,
    interval_text,
    number_cards,
    result_page,
    result_text,
)
from denoc_ros.model.joint_units import Units
from denoc_ros.model.tree import Tree
from denoc_ros.pages.figures import Curve, Ink, Panel, line_figure
from denoc_ros.pages.html_page import PageSection, PageTable, ReportPage, Verdict, engineering
from denoc_ros.pages.provenance import provenance

DRAWN = 400  # points of a curve


def model_page(document: Mapping[str, Any], command: str) -> ReportPage:
    """Return the page of a model's numbers."""
    numbers = document['parameters']
    found = [one for one in numbers if one['verdict'] == 'found']
    cards = number_cards(found)
    sections = [_numbers(numbers), _combinations(document), channels_section(document['channels'])]
    return result_page(
        document,
        'What the recordings say of the model',
        f'{len(found)} of {len(numbers)} numbers are found',
        cards,
        sections,
        command,
    )


def model_text(document: Mapping[str, Any]) -> str:
    """Return the lines of a model's numbers for a terminal."""
    notes = [*document['not_identifiable'], *document['reasons']]
    head = [_text(_numbers(document['parameters'])), '']
    return result_text(document, head, _text(channels_section(document['channels'])), notes)


def _text(section: PageSection) -> str:
    """Return the tables of a section for a terminal."""
    return '\n'.join(table.text() for table in section.tables)


def _numbers(numbers: Sequence[Mapping[str, Any]]) -> PageSection:
    text = (
        'Found: known within 5 %. Doubtful: within 50 %, or the held-out part of a run is not '
        'explained as well as the rest. Of numbers that may have any sign, these are shares of '
        'what they add to; the table has half their interval. SI units.'
    )
    return PageSection('Numbers', text, tables=[numbers_table(numbers)])


def numbers_table(
    numbers: Sequence[Mapping[str, Any]],
    verdict: Callable[[Mapping[str, Any]], str] = verdict_text,
) -> PageTable:
    """Return the table of a robot's numbers: where the search began, what is found."""
    rows = [
        [
            one['path'],
            f'{one["start"]:.5g}',
            f'{one["value"]:.5g}',
            interval_text(one['interval']),
            verdict(one),
        ]
        for one in numbers
    ]
    return PageTable(['number', 'was', 'is', '', 'verdict'], rows)


def _combinations(document: Mapping[str, Any]) -> PageSection | None:
    lines = [[line] for line in document['not_identifiable']]
    if not lines:
        return None
    text = 'What these data do tell of numbers that they do not tell one by one.'
    return PageSection('Not identifiable', text, tables=[PageTable([''], lines)])


def channels_section(channels: Sequence[Mapping[str, Any]]) -> PageSection:
    """Return the section on what of each measured channel the model leaves."""
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


def excitation_page(
    found: Excitation, document: Mapping[str, Any], tree: Tree, command: str
) -> ReportPage:
    """Return the page of a motion that identifies."""
    numbers = document['parameters']
    good = [one for one in numbers if one['verdict'] == 'found']
    cards = number_cards(good)
    text = (
        f'After this motion {len(good)} of {len(numbers)} numbers are known within 5 %; the '
        f'search made intervals {document["gain"]:.3g} times shorter than after the best motion '
        f'drawn at random, in {document["seconds"]:.1f} s.'
    )
    return ReportPage(
        title='The motion that tells most',
        subtitle=f'{tree.name} · {found.duration:g} s from rest to rest',
        verdict=Verdict(text, TONES[document['verdict']]),
        cards=cards,
        sections=[
            _expected(document),
            _motion(found, Units.of(tree)),
            _limits(document),
            _never(document),
            _noise(document),
        ],
        provenance=provenance(command, {'robot': document['robot']}),
    )


def excitation_text(document: Mapping[str, Any]) -> str:
    """Return the lines of a motion that identifies for a terminal."""
    parameters, never = document['parameters'], document['not_by_any_motion']
    seen = document['combinations_seen']
    notes = [f'{seen} of {len(parameters)} combinations are seen by any motion']
    notes += [f'by no motion: {line}' for line in never]
    return '\n'.join([
        _text(_expected(document)),
        '',
        _text(_limits(document)),
        *(f'  {note}' for note in notes),
        f'{document["output"]}: {document["duration_s"]:g} s from rest to rest',
        f'  found in {document["seconds"]:.1f} s: intervals {document["gain"]:.3g} times shorter '
        'than after the best motion drawn',
        f'expected verdict: {document["verdict"]}',
    ])  # fmt: skip


def _expected(document: Mapping[str, Any]) -> PageSection:
    rows = [
        [one['path'], f'{one["value"]:.5g}', interval_text(one['interval']), one['verdict']]
        for one in document['parameters']
    ]
    text = (
        'What `denoc identify model` is to say of a recording of this motion, if the numbers are '
        'near those of the model. SI units.'
    )
    table = PageTable(['number', 'is', 'expected', ''], rows)
    tables = [table]
    if document['not_identifiable']:
        lines = [[line] for line in document['not_identifiable']]
        tables.append(PageTable(['not one by one, by this motion'], lines))
    return PageSection('Intervals to expect', text, tables=tables)


def _motion(found: Excitation, units: Units) -> PageSection:
    rows = found.rows(np.linspace(0.0, found.duration, DRAWN))
    panels = []
    for k, joint in enumerate(found.joints):
        unit = units.position(joint)
        for what, values, per in (('', rows.q, ''), (', velocity', rows.qd, '/s')):
            curve = Curve(joint, Ink.PHASES[0], rows.t, values[:, k])
            panels.append(Panel(f'{joint}{what}', unit + per, [curve]))
    text = 'A Fourier series of each joint; velocity, acceleration and jerk are 0 at both ends.'
    return PageSection('The motion', text, [line_figure(panels)])


def _limits(document: Mapping[str, Any]) -> PageSection:
    rows = [
        [
            f'{one["what"]} {one["name"]}',
            engineering(one['value'], one['unit']),
            engineering(one['limit'], one['unit']),
            f'{100.0 * one["value"] / one["limit"]:.0f} %',
        ]
        for one in document['limits']
    ]
    text = (
        'The largest magnitudes on this model; positions count from the middle of their range. '
        'Collisions are not looked at: make the ranges of the joints as narrow as needed.'
    )
    return PageSection('Limits', text, tables=[PageTable(['', 'largest', 'limit', ''], rows)])


def _never(document: Mapping[str, Any]) -> PageSection | None:
    lines = [[line] for line in document['not_by_any_motion']]
    if not lines:
        return None
    text = (
        f'{document["combinations_seen"]} of {len(document["parameters"])} combinations are seen '
        'by any of the motions tried, whatever the noise. The others need another sensor, another '
        'direction of gravity or a known payload.'
    )
    return PageSection('What no motion shows', text, tables=[PageTable([''], lines)])


def _noise(document: Mapping[str, Any]) -> PageSection:
    rows = [
        [name, 'not recorded' if value is None else f'{value:.4g}']
        for name, value in document['noise'].items()
    ]
    text = (
        'Standard deviation of one sample of each channel that the intervals assume, at '
        f'{document["rate_hz"]:g} Hz.'
    )
    return PageSection('Noise', text, tables=[PageTable(['channel', 'deviation'], rows)])
