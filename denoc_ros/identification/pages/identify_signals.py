"""Pages and texts of `denoc identify modal`, `forced` and `joint`: the signal and its fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from denoc_ros.identification.decay.analysis import (
    DecayAnalysis,
    held_out,
    own_decay,
    residual_spectrum,
)
from denoc_ros.identification.decay.forced import ForcedModes
from denoc_ros.identification.decay.records import Record
from denoc_ros.identification.decay.spectra import SpectralDecay, waterfall
from denoc_ros.identification.joint.joint_swing import FrictionModel, JointFit
from denoc_ros.identification.joint.swing import swing_angles
from denoc_ros.identification.pages.identify_result import (
    SHOWN,
    fit_figure,
    interval_text,
    mode_cards,
    mode_notes,
    modes_found,
    result_page,
    result_text,
)
from denoc_ros.identification.servo.servo_fit import Run, ServoFit
from denoc_ros.pages.figures import RESULT_HEIGHT, Curve, Ink, Panel, line_figure
from denoc_ros.pages.html_page import Card, PageSection, PageTable, ReportPage, engineering
from denoc_ros.text_table import cell_text, text_table
from denoc_ros.types import Array

SLICES = 12  # of a waterfall
DRAWN = 0.1  # standard deviations of the noise that a decay is drawn down to


def decay_page(document: Mapping[str, Any], analysis: DecayAnalysis, command: str) -> ReportPage:
    """Return the page of one recording's modes."""
    return result_page(
        document,
        f'Modes of {analysis.record.name}',
        modes_found(document),
        mode_cards(document),
        [
            _decay(analysis),
            _held_out(analysis),
            _envelopes(analysis),
            _amplitude_dependence(analysis),
            _waterfall(analysis),
            _residual(analysis),
            _methods(document),
        ],
        command,
    )


def _unused(source: Mapping[str, Any]) -> str:
    """Return how many rows of a recording are used, where it is not all."""
    rows, used = source['rows'], source['used_rows']
    return f'; {used} of {rows} rows are used' if used < rows else ''


def decay_text(document: Mapping[str, Any]) -> str:
    """Return the lines of a result of modes for a terminal."""
    source, window, quality = document['source'], document['window'], document['quality']
    signal = ' '.join(filter(None, (source['topic'], source['field'], source['quantity'])))
    head = [
        f'{source["file"]}: {signal}',
        f'  {window["begin_s"]:.4g} … {window["end_s"]:.4g} s ({window["by"]}), '
        f'{quality["samples"]} samples at {quality["rate"]:.4g} Hz{_unused(source)}',
    ]
    rows = [
        {
            'f [Hz]': mode['frequency_hz'],
            'zeta': mode['damping_ratio'],
            '95 %': interval_text(mode['interval']).removeprefix('95 %: '),
            'bound': f'{100.0 * mode["bound"]:.2g} %' if mode['bound'] is not None else '-',
            'SNR [dB]': mode['snr_db'],
            'verdict': mode['verdict'],
        }
        for mode in document['modes']
    ]
    notes = []
    for mode in document['modes']:
        name = f'{mode["frequency_hz"]:.4g} Hz'
        notes += [f'{name}: {reason}' for reason in mode['reasons']]
        for check in mode['checks']:
            zeta = check['damping_ratio']
            found = ['' if zeta is None else f'zeta {zeta:.4g}', check['reason']]
            notes.append(f'{name}, {check["method"]}: {", ".join(filter(None, found))}')
        if one := mode.get('coefficient'):
            notes.append(
                f'{name}: {one["value"]:.4g} {one["unit"]} of {one["of"]} ({one["scaling"]}), '
                f'{one["path"]} {one["damping_ratio_at_fixed_root"]:.4g}'
            )
    notes += [
        f'no mode: {line["frequency"]:.4g} Hz, {line["origin"]}' for line in document['lines']
    ]
    notes += document['remarks']
    if note := document.get('model', {}).get('left_out'):
        notes.append(f'coefficients left out: {note}')
    return result_text(document, head, text_table(rows), notes)


def _decay(analysis: DecayAnalysis) -> PageSection:
    record, modes = analysis.record, analysis.modes
    figure = fit_figure(record.t, record.y, modes.prediction(record.t), record.name, record.unit)
    return PageSection(
        'Measured and fitted',
        f'Damped cosines, an offset and a drift. The residual has a standard deviation of '
        f'{engineering(modes.noise, record.unit)}.',
        [figure],
    )


def _held_out(analysis: DecayAnalysis) -> PageSection | None:
    found = held_out(analysis.record)
    if found is None or not len(found[0].frequency):
        return None
    modes, split = found
    record = analysis.record
    rest = record.t > split
    t, y = record.t[rest], record.y[rest]
    predicted = modes.prediction(t)
    swing = float(np.std(y)) or 1.0
    error = float(np.sqrt(np.mean((y - predicted) ** 2)))
    panel = Panel(
        'not seen by the fit',
        record.unit,
        [
            Curve('measured', Ink.TRUTH, t, y),
            Curve('simulated', Ink.PHASES[1], t, predicted, True),
        ],
    )
    return PageSection(
        'Measured and simulated, held out',
        f'Modes identified up to {split:.4g} s, and simulated from there. Their error is '
        f'{engineering(error, record.unit)} rms, {100.0 * error / swing:.2g} % of the rms of '
        'the measured signal.',
        [line_figure([panel], RESULT_HEIGHT)],
    )


def _envelopes(analysis: DecayAnalysis) -> PageSection | None:
    modes, record = analysis.modes, analysis.record
    panels = []
    for k, frequency in enumerate(modes.frequency):
        own = np.abs(own_decay(analysis, k))
        crest = _crests(record.t, own, 0.5 / frequency)
        rate = 2.0 * np.pi * frequency * modes.damping_ratio[k]
        fit = modes.amplitude[k] * np.exp(-rate * (record.t - modes.start))
        seen = fit > DRAWN * modes.noise
        ends = record.t[[0, -1]]
        panels.append(
            Panel(
                f'{frequency:.4g} Hz, ζ {modes.damping_ratio[k]:.4g}',
                record.unit,
                [
                    Curve('crests', Ink.TRUTH, record.t[crest], own[crest], marker='.'),
                    Curve('fitted', Ink.PHASES[0], record.t[seen], fit[seen]),
                    Curve('noise', Ink.DIFFERENCE, ends, np.full(2, modes.noise), True),
                    *_spectral(analysis.spectra[k]),
                ],
                log_y=True,
            )
        )
    if not panels:
        return None
    return PageSection(
        'Decay of each mode',
        'Crests of the record without the other modes, on a logarithmic axis: a damping that does '
        'not depend on amplitude is a straight line down to the noise.',
        [line_figure(panels, RESULT_HEIGHT)],
    )


def _crests(t: Array, size: Array, half_cycle: float) -> NDArray[np.intp]:
    """Return the place of the largest sample of each half cycle."""
    cells = ((t - t[0]) / half_cycle).astype(np.intp)
    order = np.lexsort((size, cells))
    last = np.flatnonzero(np.diff(cells[order], append=-1))
    return np.asarray(order[last][size[order[last]] > 0.0])


def _spectral(decay: SpectralDecay) -> list[Curve]:
    if decay.reasons:
        return []
    used = decay.used
    return [
        Curve('evolving spectra', Ink.PHASES[1], decay.time[used], decay.magnitude[used], True)
    ]


def _waterfall(analysis: DecayAnalysis) -> PageSection | None:
    modes = analysis.modes
    if not len(modes.frequency):
        return None
    window = analysis.spectra[int(np.argmax(modes.amplitude))].window
    fall = waterfall(analysis.record, window)
    if len(fall.time) < 2:
        return None
    chosen = np.unique(np.linspace(0, len(fall.time) - 1, SLICES).astype(np.intp))
    shown = fall.frequency < min(2.5 * modes.frequency.max(), fall.frequency[-1])
    step = 0.25 * float(fall.magnitude.max())
    curves = [
        Curve('', Ink.PHASES[1], fall.frequency[shown], fall.magnitude[k][shown] + step * place)
        for place, k in enumerate(chosen)
    ]
    panel = Panel(
        f'from {fall.time[0]:.3g} s (lowest) to {fall.time[-1]:.3g} s',
        analysis.record.unit,
        curves,
        x_label='frequency [Hz]',
    )
    return PageSection(
        'Evolving spectra',
        f'Spectra of windows of {window:.3g} s moved along the decay, each a step above the '
        'one before. If two modes merge into one peak, or the window is longer than twice the '
        "mode's time constant, the method does not hold.",
        [line_figure([panel], 2.0 * RESULT_HEIGHT)],
    )


def _amplitude_dependence(analysis: DecayAnalysis) -> PageSection | None:
    modes, unit = analysis.modes, analysis.record.unit
    panels = []
    for k, curve in enumerate(modes.curves):
        if curve is None:
            continue
        level = np.full(2, modes.damping_ratio[k])
        panels.append(
            Panel(
                f'{modes.frequency[k]:.4g} Hz' + (', depends' if curve.dependent else ''),
                '',
                [
                    Curve(
                        'window, 95 % from noise',
                        Ink.PHASES[1],
                        curve.amplitude,
                        curve.damping_ratio,
                        marker='o',
                        error=1.96 * curve.deviation,
                    ),
                    Curve('whole', Ink.PHASES[0], curve.amplitude[[0, -1]], level, True),
                ],
                x_label=f'amplitude [{unit}]' if unit else 'amplitude',
                log_x=True,
            )
        )
    if not panels:
        return None
    return PageSection(
        'Damping ratio against amplitude',
        'The same mode fitted in windows along its decay. Where the windows differ by more than '
        'noise explains, one number does not describe the damping, and the interval is the one '
        'of the windows.',
        [line_figure(panels, RESULT_HEIGHT)],
    )


def _residual(analysis: DecayAnalysis) -> PageSection:
    frequency, signal, rest = residual_spectrum(analysis)
    floor = max(float(rest.max()) * 1e-3, 1e-300)
    curves = [
        Curve('measured', Ink.TRUTH, frequency[1:], np.maximum(signal[1:], floor)),
        Curve('residual', Ink.PHASES[0], frequency[1:], np.maximum(rest[1:], floor)),
    ]
    panel = Panel('amplitude', analysis.record.unit, curves, x_label='frequency [Hz]', log_y=True)
    rows = [
        [f'{line.frequency:.4g}', engineering(line.amplitude, analysis.record.unit), line.origin]
        for line in analysis.modes.lines
    ]
    return PageSection(
        'Spectrum of the residual',
        'A peak that is left is a mode or a line that was not found; a flat residual is noise.',
        [line_figure([panel], RESULT_HEIGHT)],
        [PageTable(['line [Hz]', 'amplitude', 'is no mode but'], rows)] if rows else [],
    )


def _methods(document: Mapping[str, Any]) -> PageSection | None:
    rows = []
    for mode in document['modes']:
        shown = f'{mode["frequency_hz"]:.4g} Hz'
        value = f'{mode["damping_ratio"]:.4g}'
        rows.append([shown, document['method'], value, '; '.join(mode['reasons'])])
        rows += [
            ['', check['method'], cell_text(check['damping_ratio']), check['reason']]
            for check in mode['checks']
        ]
    if not rows:
        return None
    return PageSection(
        'Methods',
        'Results of other methods for the same decay, and why they differ or do not apply.',
        tables=[PageTable(['mode', 'method', 'ζ', 'remark'], rows)],
    )


def forced_page(
    document: Mapping[str, Any], record: Record, found: ForcedModes, command: str
) -> ReportPage:
    """Return the page of modes from inputs and response; arguments as of `decay_page`."""
    explained = f'{100.0 * document["explained"]:.1f} % of the response explained'
    return result_page(
        document,
        f'Forced response of {record.name}',
        f'{modes_found(document)}; {explained}',
        mode_cards(document),
        [_response(found)],
        command,
    )


def forced_text(document: Mapping[str, Any]) -> str:
    """Return the lines of a result of modes from inputs and response for a terminal."""
    source = document['source']
    head = (
        f'{source["file"]}: {source["field"]} from {source["force"]}, '
        f'{100.0 * document["explained"]:.1f} % explained'
    )
    rows = [
        {
            'f [Hz]': mode['frequency_hz'],
            'zeta': mode['damping_ratio'],
            '95 %': mode['interval'],
            'strength': mode['strength'],
            'verdict': mode['verdict'],
        }
        for mode in document['modes']
    ]
    notes = [*mode_notes(document), *document['remarks']]
    return result_text(document, [head], text_table(rows), notes)


def _response(found: ForcedModes) -> PageSection:
    inputs = found.measured.shape[1]
    panels = [
        Panel(
            title + (f', input {k + 1}' if inputs > 1 else ''),
            unit,
            [
                Curve('measured', Ink.TRUTH, found.line, of(found.measured[:, k]), marker='.'),
                Curve('fitted', Ink.PHASES[0], found.line, of(found.fitted[:, k])),
            ],
            x_label='frequency [Hz]',
            log_y=log,
        )
        for k in range(inputs)
        for title, unit, of, log in (
            ('response over input, magnitude', '', np.abs, True),
            ('phase', 'rad', np.angle, False),
        )
    ]
    return PageSection(
        'Frequency response',
        'Ratio of the transforms at the lines that the input excites, and the fitted modes.',
        [line_figure(panels, RESULT_HEIGHT)],
    )


def joint_page(
    document: Mapping[str, Any], record: Record, fit: JointFit, command: str
) -> ReportPage:
    """Return the page of one joint's friction."""
    return result_page(
        document,
        f'Friction of {record.name}',
        f'{" and ".join(document["terms"]).capitalize()} friction explain the swing to '
        f'{engineering(fit.residual, "rad")} rms',
        _friction_cards(document),
        [_swing(record, fit), _models(record, fit), _decrement(document)],
        command,
    )


def joint_text(document: Mapping[str, Any]) -> str:
    """Return the lines of a joint's friction for a terminal."""
    source = document['source']
    head = [
        f'{source["file"]}: {source["topic"]} {source["field"]}'.replace('  ', ' '),
        f'  small swings without friction: {document["frequency_hz"]:.4g} Hz',
    ]
    rows = [
        {'term': name, 'value': one['value'], '95 %': one['interval'], 'unit': one['unit']}
        for name, one in document['terms'].items()
    ]
    notes = [
        f'{" + ".join(model["terms"])}: residual {model["residual"]:.4g}, '
        f'{model["rejected"] or "chosen"}'
        for model in document['models']
    ]
    for one in document['decrement']:
        said = one['reason'] or f'zeta {one["damping_ratio"]:.4g} at {one["frequency_hz"]:.4g} Hz'
        if one['coefficient'] is not None:
            said += f', coefficient {one["coefficient"]:.4g} {one["unit"]}'
        notes.append(f'log decrement ({one["convention"]}): {said}')
    return result_text(document, head, text_table(rows), [*notes, *document['reasons']])


def _friction_cards(document: Mapping[str, Any]) -> list[Card]:
    cards = [Card('Small swings', f'{document["frequency_hz"]:.4g} Hz', 'without friction')]
    for name, one in document['terms'].items():
        note = interval_text(one['interval'])
        cards.append(Card(f'{name} friction', f'{one["value"]:.4g} {one["unit"]}', note))
    return cards


def _swing(record: Record, fit: JointFit) -> PageSection:
    fitted = fit.prediction(record.t)
    return PageSection(
        'Measured and simulated',
        'The equation of motion with the fitted friction. The residual is '
        f'{engineering(fit.residual, "rad")} rms while the joint moves.',
        [fit_figure(record.t, record.y, fitted, 'angle', 'rad', 'simulated')],
    )


def _models(record: Record, fit: JointFit) -> PageSection:
    def angles(model: FrictionModel) -> Curve:
        shown = swing_angles(model.swing, record.t - fit.start, fit.large)
        colour = Ink.PHASES[fit.models.index(model) % len(Ink.PHASES)]
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


# servos of joints --------------------------------------------------------------------------------


def servo_page(
    document: Mapping[str, Any], found: Sequence[tuple[ServoFit, Run]], command: str
) -> ReportPage:
    """Return the page of the joints' servos.

    Parameters
    ----------
    found : sequence of (ServoFit, Run)
        Of each joint that moved, with its recordings.
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
    sections = [_followed(fit, *rows) for fit, rows in found]
    return result_page(
        document,
        'How the joints follow their commands',
        said or 'No joint was told to move',
        cards,
        [
            *sections,
            PageSection('Servos', 'For the shaper.', tables=[_servos(document)]),
        ],
        command,
    )


def servo_text(document: Mapping[str, Any]) -> str:
    """Return the lines of the joints' servos for a terminal, with the shaper's parameters."""
    source, joints, still = document['source'], document['joints'], document['not_moved']
    head = f'{source["file"]}: {source["topic"]} after {source["command"]}'
    parameters = []
    for name, key in (('bandwidth', 'bandwidth_hz'), ('damping', 'damping'), ('delay', 'delay_s')):
        if joints and not still:
            values = ', '.join(f'{one[key]:.4g}' for one in joints.values())
            parameters.append(f'servo.{name}: [{values}]')
    table = _servos(document).text() if joints else ''
    return result_text(document, [head], table, [*still, *document['reasons']], parameters)


def _followed(fit: ServoFit, t: Array, told: Array, measured: Array) -> PageSection:
    commanded = Curve('told', Ink.DIFFERENCE, t, told)
    figure = fit_figure(t, measured, fit.fitted, 'position', 'rad', above=[commanded])
    return PageSection(
        fit.joint,
        f'{engineering(fit.distance, "rad")} rms from its command, '
        f'{engineering(fit.residual, "rad")} rms from the fit.',
        [figure],
    )


def _servos(document: Mapping[str, Any]) -> PageTable:
    numbers = ('bandwidth_hz', 'damping', 'delay_s', 'gain')
    rows = []
    for name, one in document['joints'].items():
        row = [name]
        for number in numbers:
            interval = one['interval'][number.partition('_')[0]]
            row += [f'{one[number]:.4g}', interval_text(interval)]
        rows.append([*row, f'{one["lag_s"]:.4g}', one['verdict']])
    head = ['joint', 'bandwidth [Hz]', '', 'ζ', '', 'delay [s]', '', 'gain', '', 'lag [s]']
    return PageTable([*head, 'verdict'], rows)
