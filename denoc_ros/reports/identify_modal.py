"""The page of `denoc identify modal`: the decay, its fit, and its reliability."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from denoc_ros.identification.analysis import (
    DecayAnalysis,
    held_out,
    own_decay,
    residual_spectrum,
)
from denoc_ros.identification.spectra import SpectralDecay, waterfall
from denoc_ros.reports.figures import (
    DIFFERENCE_COLOUR,
    PHASE_COLOURS,
    RESULT_HEIGHT,
    TRUTH_COLOUR,
    Curve,
    Panel,
    line_figure,
)
from denoc_ros.reports.identify_result import mode_cards, modes_found, result_page
from denoc_ros.reports.pages import PageSection, PageTable, ReportPage, engineering
from denoc_ros.reports.text_table import cell_text
from denoc_ros.types import Array

SLICES = 12  # of a waterfall
SHOWN = 0.1  # standard deviations of the noise that a decay is drawn down to


def decay_page(document: Mapping[str, Any], analysis: DecayAnalysis, command: str) -> ReportPage:
    """Return the page of one recording's modes.

    Parameters
    ----------
    document : mapping
        The result, as in result.yaml.
    analysis : DecayAnalysis
        What it is from.
    command : str
        The command line.
    """
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


def _decay(analysis: DecayAnalysis) -> PageSection:
    record, modes = analysis.record, analysis.modes
    fitted = modes.prediction(record.t)
    panels = [
        Panel(
            record.name,
            record.unit,
            [
                Curve('measured', TRUTH_COLOUR, record.t, record.y),
                Curve('fitted', PHASE_COLOURS[0], record.t, fitted, True),
            ],
        ),
        Panel(
            'measured minus fitted',
            record.unit,
            [Curve('difference', DIFFERENCE_COLOUR, record.t, record.y - fitted)],
        ),
    ]
    return PageSection(
        'Measured and fitted',
        f'Damped cosines, an offset and a drift. The residual has a standard deviation of '
        f'{engineering(modes.noise, record.unit)}.',
        [line_figure(panels, RESULT_HEIGHT)],
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
            Curve('measured', TRUTH_COLOUR, t, y),
            Curve('simulated', PHASE_COLOURS[1], t, predicted, True),
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
        seen = fit > SHOWN * modes.noise
        ends = record.t[[0, -1]]
        panels.append(
            Panel(
                f'{frequency:.4g} Hz, ζ {modes.damping_ratio[k]:.4g}',
                record.unit,
                [
                    Curve('crests', TRUTH_COLOUR, record.t[crest], own[crest], marker='.'),
                    Curve('fitted', PHASE_COLOURS[0], record.t[seen], fit[seen]),
                    Curve('noise', DIFFERENCE_COLOUR, ends, np.full(2, modes.noise), True),
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
        Curve('evolving spectra', PHASE_COLOURS[1], decay.time[used], decay.magnitude[used], True)
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
        Curve(
            '',
            PHASE_COLOURS[1],
            fall.frequency[shown],
            fall.magnitude[k][shown] + step * place,
        )
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
                        PHASE_COLOURS[1],
                        curve.amplitude,
                        curve.damping_ratio,
                        marker='o',
                        error=1.96 * curve.deviation,
                    ),
                    Curve('whole', PHASE_COLOURS[0], curve.amplitude[[0, -1]], level, True),
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
        Curve('measured', TRUTH_COLOUR, frequency[1:], np.maximum(signal[1:], floor)),
        Curve('residual', PHASE_COLOURS[0], frequency[1:], np.maximum(rest[1:], floor)),
    ]
    panel = Panel(
        'amplitude',
        analysis.record.unit,
        curves,
        x_label='frequency [Hz]',
        log_y=True,
    )
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
