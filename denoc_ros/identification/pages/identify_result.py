"""Parts that pages and texts of `denoc identify` share: verdict, modes, fit, record."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from denoc_ros.pages.figures import RESULT_HEIGHT, Curve, Figure, Ink, Panel, line_figure
from denoc_ros.pages.html_page import Card, PageSection, PageTable, ReportPage, Tone, Verdict
from denoc_ros.pages.provenance import provenance
from denoc_ros.text_table import cell_text, text_table
from denoc_ros.types import Array

TONES: Mapping[str, Tone] = {'good': 'good', 'doubtful': 'doubtful', 'not identifiable': 'bad'}
SHOWN = 4  # modes or numbers on cards


def result_page(
    document: Mapping[str, Any],
    title: str,
    found: str,
    cards: Sequence[Card],
    sections: Sequence[PageSection | None],
    command: str,
) -> ReportPage:
    """Return the page of a result.

    Parameters
    ----------
    found : str
        What was found, in a sentence without its full stop.
    """
    source = document['source']
    file = Path(source['file']).name
    model = document.get('model', {})
    sources = {
        'recording': f'{file}, SHA-256 {source["sha256"]}',
        'robot': Path(model.get('file', '')).name,
    }
    return ReportPage(
        title=title,
        subtitle=f'{file} · {document["method"]}',
        verdict=_verdict(document, found),
        cards=cards,
        sections=[*sections, _about(document)],
        provenance=provenance(command, sources, document['versions']),
    )


def mode_cards(document: Mapping[str, Any]) -> list[Card]:
    """Return a card for each of the first modes: frequency, damping ratio, interval."""
    cards = []
    for mode in document['modes'][:SHOWN]:
        note = f'{interval_text(mode["interval"])}, {mode["verdict"]}'
        cards.append(
            Card(f'{mode["frequency_hz"]:.4g} Hz', f'ζ {mode["damping_ratio"]:.4g}', note)
        )
    return cards


def number_cards(numbers: Sequence[Mapping[str, Any]]) -> list[Card]:
    """Return a card for each of the first numbers of a model: value, interval."""
    return [
        Card(one['path'], f'{one["value"]:.5g}', interval_text(one['interval']))
        for one in numbers[:SHOWN]
    ]


def interval_text(interval: Sequence[float | None]) -> str:
    """Return a 95 % interval in words; an end that is not finite is None."""
    if None in interval:
        return '95 %: not determined'
    low, high = interval
    return f'95 %: {low:.4g} … {high:.4g}'


def result_text(
    document: Mapping[str, Any],
    head: Iterable[str],
    table: str,
    notes: Iterable[str] = (),
    tail: Iterable[str] = (),
) -> str:
    """Return a result's lines for a terminal."""
    modes = document.get('modes', ())
    asked = [f'{mode["frequency_hz"]:.4g}' for mode in modes if mode['asked']]
    of = f' (of {", ".join(asked)} Hz)' if len(modes) > len(asked) > 0 else ''
    none = ' (no mode asked for was found)' if modes and not asked else ''
    lines = [*head, *filter(None, [table]), *(f'  {note}' for note in notes), *tail]
    return '\n'.join([*lines, f'verdict: {document["verdict"]}{of}{none}'])


def mode_notes(document: Mapping[str, Any]) -> list[str]:
    """Return the reasons of each mode's verdict, for a terminal."""
    return [
        f'{mode["frequency_hz"]:.4g} Hz: {reason}'
        for mode in document['modes']
        for reason in mode['reasons']
    ]


def fit_figure(
    t: Array,
    measured: Array,
    fitted: Array,
    name: str,
    unit: str,
    word: str = 'fitted',
    above: Sequence[Curve] = (),
) -> Figure:
    """Return the figure of a signal and its fit, and of their difference below.

    Parameters
    ----------
    t, measured, fitted : (k,) array
        Times [s] and values.
    """
    curves = [
        Curve('measured', Ink.TRUTH, t, measured),
        Curve(word, Ink.PHASES[0], t, fitted, True),
    ]
    difference = Curve('difference', Ink.DIFFERENCE, t, measured - fitted)
    panels = [
        Panel(name, unit, [*above, *curves]),
        Panel(f'measured minus {word}', unit, [difference]),
    ]
    return line_figure(panels, RESULT_HEIGHT)


def modes_found(document: Mapping[str, Any]) -> str:
    """Return the modes of a result in words."""
    modes = document['modes']
    if not modes:
        return 'No mode was found'
    listed = ', '.join(
        f'{mode["frequency_hz"]:.4g} Hz with ζ {mode["damping_ratio"]:.3g}' for mode in modes
    )
    return f'{len(modes)} mode{"s" * (len(modes) > 1)}: {listed}'


# of a document: said in the head, on the page, or not a number
ABOUT = ('kind', 'source', 'window', 'quality', 'method', 'verdict', 'reasons', 'versions')


def values_text(document: Mapping[str, Any]) -> str:
    """Return the values of a result for a terminal, where they have no text of their own."""
    rows = [{'': name, 'value': value} for name, value in _values(document).items()]
    return result_text(
        document, [document['source']['file']], text_table(rows), document['reasons']
    )


def values_page(document: Mapping[str, Any], command: str) -> ReportPage:
    """Return the page of a result's values, where they have none of their own."""
    rows = [[name, cell_text(value)] for name, value in _values(document).items()]
    section = PageSection('Values', document['method'], tables=[PageTable(('', ''), rows)])
    found = f'{len(rows)} value{"s" * (len(rows) != 1)}'
    return result_page(document, document['kind'].capitalize(), found, [], [section], command)


def _values(document: Mapping[str, Any]) -> dict[str, Any]:
    return {name.replace('_', ' '): value for name, value in document.items() if name not in ABOUT}


def _verdict(document: Mapping[str, Any], found: str) -> Verdict:
    tone = TONES[document['verdict']]
    reasons = document['reasons'] if tone != 'good' else ()
    said = '; '.join([found, *dict.fromkeys(reasons)])
    return Verdict(f'{said}.', tone)


def _about(document: Mapping[str, Any]) -> PageSection:
    source = {**document['source'], **document['source'].get('calibration', {})}
    source.pop('calibration', None)
    source['file'] = Path(source['file']).name
    both = {**source, **document.get('window', {}), **document.get('quality', {})}
    rows = [[name.replace('_', ' '), cell_text(value)] for name, value in both.items()]
    return PageSection(
        'Record',
        'Origin and quality of the record.',
        tables=[PageTable(('', ''), rows, folded=True, title='source, calibration, quality')],
    )
