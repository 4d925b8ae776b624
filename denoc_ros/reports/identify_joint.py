"""The page of `denoc identify joint`: the swing, its fit, and the significant friction terms."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from denoc_ros.identification.joint import FrictionModel, JointFit
from denoc_ros.identification.records import Record
from denoc_ros.identification.swing import swing_angles
from denoc_ros.reports.figures import (
    DIFFERENCE_COLOUR,
    PHASE_COLOURS,
    RESULT_HEIGHT,
    TRUTH_COLOUR,
    Curve,
    Panel,
    line_figure,
)
from denoc_ros.reports.identify_result import interval_text, result_page
from denoc_ros.reports.pages import Card, PageSection, PageTable, ReportPage, engineering
from denoc_ros.reports.text_table import cell_text


def joint_page(
    document: Mapping[str, Any], record: Record, fit: JointFit, command: str
) -> ReportPage:
    """Return the page of one joint's friction.

    Parameters
    ----------
    document : mapping
        The result, as in result.yaml.
    record : Record
        The swing.
    fit : JointFit
        What was found.
    command : str
        The command line.
    """
    return result_page(
        document,
        f'Friction of {record.name}',
        f'{" and ".join(document["terms"]).capitalize()} friction explain the swing to '
        f'{engineering(fit.residual, "rad")} rms',
        _cards(document),
        [_swing(record, fit), _models(record, fit), _decrement(document)],
        command,
    )


def _cards(document: Mapping[str, Any]) -> list[Card]:
    cards = [Card('Small swings', f'{document["frequency_hz"]:.4g} Hz', 'without friction')]
    for name, one in document['terms'].items():
        note = interval_text(one['interval'])
        cards.append(Card(f'{name} friction', f'{one["value"]:.4g} {one["unit"]}', note))
    return cards


def _swing(record: Record, fit: JointFit) -> PageSection:
    fitted = fit.prediction(record.t)
    panels = [
        Panel(
            'angle',
            'rad',
            [
                Curve('measured', TRUTH_COLOUR, record.t, record.y),
                Curve('simulated', PHASE_COLOURS[0], record.t, fitted, True),
            ],
        ),
        Panel(
            'measured minus simulated',
            'rad',
            [Curve('difference', DIFFERENCE_COLOUR, record.t, record.y - fitted)],
        ),
    ]
    return PageSection(
        'Measured and simulated',
        'The equation of motion with the fitted friction. The residual is '
        f'{engineering(fit.residual, "rad")} rms while the joint moves.',
        [line_figure(panels, RESULT_HEIGHT)],
    )


def _models(record: Record, fit: JointFit) -> PageSection:
    def angles(model: FrictionModel) -> Curve:
        shown = swing_angles(model.swing, record.t - fit.start, fit.large)
        colour = PHASE_COLOURS[fit.models.index(model) % len(PHASE_COLOURS)]
        difference = np.asarray(record.y - shown)
        return Curve(' + '.join(model.terms), colour, record.t, difference)

    panel = Panel('measured minus simulated', 'rad', [angles(model) for model in fit.models])
    rows = [
        [' + '.join(model.terms), engineering(model.residual, 'rad'), model.rejected or 'chosen']
        for model in fit.models
    ]
    return PageSection(
        'Which terms matter',
        'Each set of terms fitted to the same swing.',
        [line_figure([panel], RESULT_HEIGHT)],
        [PageTable(['terms', 'residual, rms', ''], rows)],
    )


def _decrement(document: Mapping[str, Any]) -> PageSection:
    rows = [
        [
            one['convention'],
            cell_text(one['damping_ratio']),
            cell_text(one['frequency_hz']),
            cell_text(one['critical']),
            cell_text(one['coefficient']),
            one['unit'],
            one['reason'],
        ]
        for one in document['decrement']
    ]
    head = ['convention', 'ζ', 'f [Hz]', 'critical', 'coefficient', 'unit', '']
    return PageSection(
        'Logarithmic decrement',
        'Exact: ζ = δ/√(4π² + δ²) and a critical damping of 2Iω. Book: ζ = δ/2π and 4πρaη, whose '
        'unit is not that of a torque. Both assume viscous friction and small angles.',
        tables=[PageTable(head, rows)],
    )
