"""The page of `denoc identify servo`: commanded, measured and fitted positions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from denoc_ros.identification.servo import ServoFit
from denoc_ros.reports.figures import (
    DIFFERENCE_COLOUR,
    PHASE_COLOURS,
    RESULT_HEIGHT,
    TRUTH_COLOUR,
    Curve,
    Panel,
    line_figure,
)
from denoc_ros.reports.identify_result import SHOWN, interval_text, result_page
from denoc_ros.reports.pages import Card, PageSection, PageTable, ReportPage, engineering
from denoc_ros.types import Array

Curves = Sequence[tuple[Array, Array, Array]]  # times, told, measured


def servo_page(
    document: Mapping[str, Any], fits: Sequence[ServoFit | str], curves: Curves, command: str
) -> ReportPage:
    """Return the page of the joints' servos.

    Parameters
    ----------
    document : mapping
        The result, as in result.yaml.
    fits : sequence of ServoFit or str
        What was found, or why nothing was.
    curves : sequence of (t, told, measured)
        Of each joint.
    command : str
        The command line.
    """
    found = [
        (fit, rows) for fit, rows in zip(fits, curves, strict=True) if not isinstance(fit, str)
    ]
    said = ', '.join(
        f'{fit.joint} {fit.bandwidth:.3g} Hz, ζ {fit.damping:.2g}, {1e3 * fit.delay:.2g} ms late'
        for fit, _ in found
    )
    cards = [
        Card(
            fit.joint,
            f'{fit.bandwidth:.4g} Hz',
            f'{interval_text(fit.interval["bandwidth"].tolist())}, {fit.verdict}',
        )
        for fit, _ in found[:SHOWN]
    ]
    sections = [_joint(fit, *rows) for fit, rows in found]
    return result_page(
        document,
        'How the joints follow their commands',
        said or 'No joint was told to move',
        cards,
        [*sections, _table(found)],
        command,
    )


def _joint(fit: ServoFit, t: Array, told: Array, measured: Array) -> PageSection:
    panels = [
        Panel(
            'position',
            'rad',
            [
                Curve('told', DIFFERENCE_COLOUR, t, told),
                Curve('measured', TRUTH_COLOUR, t, measured),
                Curve('fitted', PHASE_COLOURS[0], t, fit.fitted, True),
            ],
        ),
        Panel(
            'measured minus fitted',
            'rad',
            [Curve('difference', DIFFERENCE_COLOUR, t, measured - fit.fitted)],
        ),
    ]
    return PageSection(
        fit.joint,
        f'{engineering(fit.distance, "rad")} rms from its command, '
        f'{engineering(fit.residual, "rad")} rms from the fit.',
        [line_figure(panels, RESULT_HEIGHT)],
    )


def _table(found: Sequence[tuple[ServoFit, Any]]) -> PageSection:
    rows = [
        [
            fit.joint,
            f'{fit.bandwidth:.4g}',
            interval_text(fit.interval['bandwidth'].tolist()),
            f'{fit.damping:.4g}',
            interval_text(fit.interval['damping'].tolist()),
            f'{fit.delay:.4g}',
            interval_text(fit.interval['delay'].tolist()),
            f'{fit.gain:.4g}',
            interval_text(fit.interval['gain'].tolist()),
            fit.verdict,
        ]
        for fit, _ in found
    ]
    head = ['joint', 'bandwidth [Hz]', '', 'ζ', '', 'delay [s]', '', 'gain', '', 'verdict']
    return PageSection('Servos', 'For the shaper.', tables=[PageTable(head, rows)])
