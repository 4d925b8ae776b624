"""Page and text of `denoc identify servo`: commanded, measured and fitted positions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from denoc_ros.identification.servo import Run, ServoFit
from denoc_ros.reports.figures import DIFFERENCE_COLOUR, Curve
from denoc_ros.reports.identify_result import (
    SHOWN,
    fit_figure,
    interval_text,
    result_page,
    result_text,
)
from denoc_ros.reports.pages import Card, PageSection, PageTable, ReportPage, engineering
from denoc_ros.types import Array


def servo_page(
    document: Mapping[str, Any], found: Sequence[tuple[ServoFit, Run]], command: str
) -> ReportPage:
    """Return the page of the joints' servos.

    Parameters
    ----------
    document : mapping
        The result, as in result.yaml.
    found : sequence of (ServoFit, Run)
        Of each joint that moved, with its recordings.
    command : str
        The command line.
    """
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


def servo_text(document: Mapping[str, Any]) -> str:
    """Return the lines of the joints' servos for a terminal, with the shaper's parameters."""
    source, joints, still = document['source'], document['joints'], document['not_moved']
    rows = [
        {
            'joint': name,
            'bandwidth [Hz]': one['bandwidth_hz'],
            'bandwidth 95 %': one['interval']['bandwidth'],
            'damping': one['damping'],
            'damping 95 %': one['interval']['damping'],
            'delay [s]': one['delay_s'],
            'delay 95 %': one['interval']['delay'],
            'gain': one['gain'],
            'gain 95 %': one['interval']['gain'],
            'lag [s]': one['lag_s'],
            'verdict': one['verdict'],
        }
        for name, one in joints.items()
    ]
    head = f'{source["file"]}: {source["topic"]} after {source["command"]}'
    parameters = []
    for name, key in (('bandwidth', 'bandwidth_hz'), ('damping', 'damping'), ('delay', 'delay_s')):
        if joints and not still:
            values = ', '.join(f'{one[key]:.4g}' for one in joints.values())
            parameters.append(f'servo.{name}: [{values}]')
    return result_text(document, [head], rows, [*still, *document['reasons']], parameters)


def _joint(fit: ServoFit, t: Array, told: Array, measured: Array) -> PageSection:
    commanded = Curve('told', DIFFERENCE_COLOUR, t, told)
    figure = fit_figure(t, measured, fit.fitted, 'position', 'rad', above=[commanded])
    return PageSection(
        fit.joint,
        f'{engineering(fit.distance, "rad")} rms from its command, '
        f'{engineering(fit.residual, "rad")} rms from the fit.',
        [figure],
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
