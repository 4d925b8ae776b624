"""The page of `denoc check --bode`: magnitude, phase, poles and zeros at some postures."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from denoc_ros.pages.figures import Curve, Ink, Panel, line_figure
from denoc_ros.pages.html_page import (
    UNKNOWN,
    Card,
    PageSection,
    PageTable,
    ReportPage,
    Verdict,
    engineering,
)
from denoc_ros.reports.loop_response import LoopResponse, Swing

Pair = tuple[str, str]
Places = Mapping[str, LoopResponse]

COLOURS = (*Ink.PHASES, Ink.TRUTH)
SHOWN = 8  # poles and zeros of a table
HEIGHT = 2.6  # inches


def page(
    ways: Mapping[Pair, Places], robot: str, free: bool, provenance: Mapping[str, str]
) -> ReportPage:
    """Return the page.

    Parameters
    ----------
    ways : mapping
        Input and output -> name of a posture -> what was found there.
    """
    count = len(next(iter(ways.values())))
    postures = 'one posture' if count == 1 else f'{count} postures'
    others = 'free' if free else 'held'
    return ReportPage(
        title='Would a loop ring?',
        subtitle=f'{robot} · {postures} · other joints {others}',
        verdict=_verdict(ways),
        cards=[_card(pair, places) for pair, places in ways.items()],
        sections=[*(_section(pair, places) for pair, places in ways.items()), _method()],
        provenance=provenance,
    )


def _verdict(ways: Mapping[Pair, Places]) -> Verdict:
    every = [way for places in ways.values() for way in places.values()]
    ringing = [way for way in every if way.rings]
    if not ringing:
        return Verdict('No loop on these outputs is expected to ring.')
    if len(every) == 1:
        return Verdict(every[0].sentence(), 'doubtful')
    text = f'{len(ringing)} of {len(every)} are expected to ring; the first: '
    return Verdict(text + ringing[0].sentence(), 'doubtful')


def _card(pair: Pair, places: Places) -> Card:
    modes = [way.swinging_poles[0] for way in places.values() if way.swinging_poles]
    found = [mode.frequency for mode in modes]
    value = UNKNOWN
    if found:
        low, high = (f'{edge:.3g}' for edge in (min(found), max(found)))
        value = f'{low} Hz' if low == high else f'{low} to {high} Hz'
    return Card(f'{pair[0]} to {pair[1]}', value, 'lowest mode')


def _section(pair: Pair, places: Places) -> PageSection:
    unit = next(iter(places.values())).unit
    size, phase = [], []
    for index, (name, way) in enumerate(places.items()):
        colour = COLOURS[index % len(COLOURS)]
        dashed = index >= len(COLOURS)
        label = f'at ({name})'
        size.append(Curve(label, colour, way.frequencies, np.abs(way.response), dashed))
        angle = np.degrees(np.unwrap(np.angle(way.response)))
        angle -= 360.0 * np.ceil((angle[0] - 90.0) / 360.0)  # begins between -270 and 90
        phase.append(Curve(label, colour, way.frequencies, angle, dashed))
    axis = 'frequency [Hz]'
    figure = line_figure(
        [
            Panel('Magnitude', unit, size, axis, log_x=True, log_y=True),
            Panel('Phase', '°', phase, axis, log_x=True),
        ],
        HEIGHT,
    )
    told = ' '.join(
        way.sentence() if len(places) == 1 else f'At ({name}): {way.sentence()}'
        for name, way in places.items()
    )
    return PageSection(
        f'{pair[0]} to {pair[1]}', told, [figure], [_table(name, w) for name, w in places.items()]
    )


def _table(name: str, way: LoopResponse) -> PageTable:
    head = ['', 'frequency', 'damping ratio', 'time to 5 %']
    rows = [_row('pole', one) for one in way.swinging_poles[:SHOWN]]
    rows += [_row('zero', one) for one in way.swinging_zeros[:SHOWN]]
    if np.isfinite(way.unstable_zero):
        real = f'{way.unstable_zero:.3g} rad/s'
        rows.append(['zero, right half plane', real, UNKNOWN, UNKNOWN])
    return PageTable(head, rows, folded=True, title=f'Poles and zeros at ({name})')


def _row(kind: str, one: Swing) -> list[str]:
    ratio = f'{one.damping_ratio:.3g}'
    return [kind, engineering(one.frequency, 'Hz'), ratio, engineering(one.decay, 's')]


def _method() -> PageSection:
    return PageSection(
        'How this is worked out',
        'Small motions about equilibrium under gravity, from a torque at the joint; joints '
        'without friction, as they are while they move. A mode rings where its damping ratio is '
        'below 5 %. The zeros of a joint seen from its own torque are the frequencies at which '
        'the links swing while it is held: what a stiff loop leaves. A zero in the right half '
        'plane is that of an output which first moves the wrong way. Models end at the modes '
        'that their beams have: the last poles and zeros are the least exact.',
    )
