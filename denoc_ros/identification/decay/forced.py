"""Modes from a forced record: one torque or several in, one response out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from denoc_ros.errors import IdentificationError
from denoc_ros.identification.decay.channel import Channel, Reading, read_record
from denoc_ros.identification.decay.curves import NORMAL_95, pole_zeta_deviation, zeta_and_rate
from denoc_ros.identification.decay.modes import DOUBTFUL, GOOD, NOT_IDENTIFIABLE, strongest, worst
from denoc_ros.identification.decay.records import Record, assess
from denoc_ros.identification.decay.spectra import even_record
from denoc_ros.identification.identification_result import (
    doubted,
    mode_values,
    quality_of,
    source_of,
)
from denoc_ros.output_files import Document, plain
from denoc_ros.types import Array

Complex = NDArray[np.complex128]

EXCITED = 0.02  # of the input's largest line: less is not excited
MOST_MODES = 8
PATIENCE = 2  # modes more than the best fit has, tried in vain
WINDOWS = 4
ITERATIONS = 20
COST = 5.0  # of one mode, in log(lines): pole, residue and the search for it
WIDEST = 0.1  # relative deviation of a good mode's damping ratio
USELESS = 0.5
LEAST_EXPLAINED = 0.8
OF_MODE = (
    *('frequency', 'damping_ratio', 'interval', 'formal_interval', 'window_interval'),
    'strength',
)
ALIKE = 0.02  # smallest over largest singular value of the inputs: less is one input twice


@dataclass(frozen=True, eq=False)
class ForcedModes:
    """Modes of a frequency response, by rising frequency."""

    # (k,) undamped natural frequency [Hz, or cycles per sample for stamps that count samples],
    # zeta
    frequency: Array
    damping_ratio: Array
    interval: Array  # (k, 2) 95 % interval of zeta: the wider one of the next two
    # (k, 2) from the fit's Jacobian and residual; from the spread over quarters of the record
    formal_interval: Array
    window_interval: Array
    strength: Array  # (k,) largest response of the mode alone [output's unit per input's]
    # part of the output's power at the excited lines that the modes and the start explain
    explained: float
    line: Array  # (l,) excited frequencies [Hz]
    # measured, fitted: (l, inputs) frequency response (output over one input, what the others
    # cause taken off), without and with the model
    measured: Complex
    fitted: Complex
    verdict: tuple[str, ...]
    reasons: tuple[tuple[str, ...], ...]  # what each verdict rests on, a good one too
    # what concerns the whole record, such as why there is no mode
    remarks: tuple[str, ...] = field(default=())

    @property
    def status(self) -> str:
        """Verdict on the record: its strongest mode's, `not identifiable` where there is none."""
        return self.status_of(strongest(self.frequency, self.strength))

    def status_of(self, asked: Sequence[int]) -> str:
        """Return the worst verdict of some modes, `not identifiable` where there is none."""
        return worst(tuple(self.verdict[k] for k in asked))


@dataclass(frozen=True, eq=False)
class _Lines:
    """Excited lines of one stretch: z = exp(i w), transforms of the inputs (l, n) and output."""

    z: Complex
    u: Complex
    y: Complex


@dataclass(frozen=True, eq=False)
class _Fit:
    poles: Array  # decay and angle per sample, shape (m, 2)
    residual: Complex
    jacobian: Array
    # per mode a of each input and of the start, b likewise; then the direct terms
    weights: Array

    @property
    def rss(self) -> float:
        return float(np.sum(np.abs(self.residual) ** 2))


def fit_forced(force: Record | Sequence[Record], response: Record) -> ForcedModes:
    """Identify modes from a measured input, or several at once, and the response.

    Parameters
    ----------
    force : Record or sequence of Record
        The inputs; several must differ, or what each does is not told.
    response : Record
        On the same stamps, evenly spaced but for jitter.

    Returns
    -------
    ForcedModes
        None where nothing of the response follows from the inputs; `remarks` then say so.

    Raises
    ------
    IdentificationError
        The stamps differ, an input is at rest, or inputs are the same.

    Notes
    -----
    Output = sum of modes' responses (poles and residues of the discrete transfer functions) + what
    was swinging at the start, fitted at the excited lines of the discrete Fourier transforms.
    First poles: Sanathanan and Koerner's iteration (IEEE Trans. Automatic Control 8, 1963); then
    nonlinear least squares with the linear part eliminated; number of modes by BIC.
    """
    forces = [force] if isinstance(force, Record) else list(force)
    for one in forces:
        if one.t.shape != response.t.shape or not np.array_equal(one.t, response.t):
            raise IdentificationError(
                f'{response.name}: input and response must have the same stamps, got '
                f'{one.t.size} and {response.t.size} samples'
            )
    step = response.duration / (response.t.size - 1)
    y = even_record(response).y
    y = y - y.mean()
    u = np.column_stack([_moving(one) for one in forces])
    _require_different(u, response.name)
    lines = _excited(u, y)
    return _modes(_searched(lines), lines, u, y, step)


def _moving(force: Record) -> Array:
    u = even_record(force).y
    u = u - u.mean()
    if not np.any(u):
        raise IdentificationError(f'{force.name}: the input must move, got a constant')
    return np.asarray(u)


def _require_different(u: Array, name: str) -> None:
    size = np.linalg.svd(u / np.linalg.norm(u, axis=0), compute_uv=False)
    if size[-1] < ALIKE * size[0]:
        raise IdentificationError(
            f'{name}: inputs must differ, got ones that are {100.0 * ALIKE:.0f} % or less apart'
        )


def _excited(u: Array, y: Array) -> _Lines:
    turn = np.fft.rfftfreq(len(u)) * 2.0 * np.pi
    spectrum = np.fft.rfft(u, axis=0)
    size = np.abs(spectrum)
    excited = np.any(size > EXCITED * size.max(axis=0), axis=1)
    lines = excited & (turn > 0.0) & (turn < np.pi)
    return _Lines(np.exp(1j * turn[lines]), spectrum[lines], np.fft.rfft(y)[lines])


def _searched(lines: _Lines) -> _Fit:
    """Return the fit of the least BIC over the number of modes."""
    count = lines.z.size
    best = _linear(lines, np.empty((0, 2)))
    least = count * np.log(best.rss / count)
    for modes in range(1, min(MOST_MODES, count // 8) + 1):
        if modes > len(best.poles) + PATIENCE:
            break
        for poles in _first_poles(lines, modes):
            if not len(poles):
                continue
            fit = _nonlinear(lines, poles)
            value = count * np.log(fit.rss / count) + COST * len(fit.poles) * np.log(count)
            if value < least:
                best, least = fit, value
    return best


def _first_poles(lines: _Lines, modes: int) -> list[Array]:
    """Return sets of poles: A y = B u + T solved with the last A's magnitude taken out."""
    order = 2 * modes
    powers = lines.z[:, None] ** -np.arange(order + 1)
    driven = [powers * u[:, None] for u in lines.u.T]
    weight = np.ones(lines.z.size)
    found = []
    for k in range(ITERATIONS):
        rows = np.hstack((-powers[:, 1:] * lines.y[:, None], *driven, powers))
        rows, right = rows * weight[:, None], lines.y * weight
        real = np.vstack((rows.real, rows.imag))
        solved = np.linalg.lstsq(real, np.concatenate((right.real, right.imag)), rcond=None)[0]
        denominator = np.concatenate(([1.0], solved[:order]))
        weight = 1.0 / np.maximum(np.abs(powers @ denominator), 1e-9)
        if k in (0, ITERATIONS - 1):
            found.append(_upper(np.asarray(np.roots(denominator), complex)))
    return found


def _upper(roots: Complex) -> Array:
    s = np.log(np.where(np.abs(roots) < 1e-9, 1e-9, roots))
    kept = s[(s.imag > 1e-3) & (s.imag < np.pi - 1e-3)]
    return np.column_stack((np.abs(kept.real) + 1e-9, kept.imag))


def _columns(lines: _Lines, poles: Array) -> Complex:
    """Return the linear part: per mode cosine and sine like responses to inputs and to the start.

    A pole and its conjugate with residues a -+ i b: a and b are real unknowns.
    """
    columns = []
    for sigma, omega in poles:
        pole = np.exp(-sigma + 1j * omega)
        upper, lower = 1.0 / (lines.z - pole), 1.0 / (lines.z - pole.conjugate())
        for shape in (upper + lower, 1j * (upper - lower)):
            columns += [*(shape * u for u in lines.u.T), shape * lines.z]
    columns += [*lines.u.T, *(lines.z**-1 * u for u in lines.u.T)]
    columns.append(np.ones(lines.z.size, complex))
    return np.column_stack(columns)


def _real(values: Complex) -> Array:
    return np.asarray(np.concatenate((values.real, values.imag), axis=0))


def _linear(lines: _Lines, poles: Array) -> _Fit:
    phi = _columns(lines, poles)
    weights = np.linalg.lstsq(_real(phi), _real(lines.y), rcond=1e-12)[0]
    return _Fit(poles, lines.y - phi @ weights, np.empty((0, 0)), np.asarray(weights, float))


def _nonlinear(lines: _Lines, poles: Array) -> _Fit:
    def residuals(flat: Array) -> Array:
        return _real(_linear(lines, flat.reshape(-1, 2)).residual)

    start = poles.reshape(-1)
    found = least_squares(residuals, start, x_scale=np.maximum(start, 1e-3), max_nfev=40)
    fit = _linear(lines, found.x.reshape(-1, 2))
    return _Fit(fit.poles, fit.residual, found.jac, fit.weights)


def _modes(fit: _Fit, lines: _Lines, u: Array, y: Array, step: float) -> ForcedModes:
    order = [
        int(k) for k in np.argsort(fit.poles[:, 1]) if _inside(fit.poles[k], np.angle(lines.z))
    ]
    values = np.array([zeta_and_rate(*fit.poles[k]) for k in order]).reshape(-1, 2)
    formal = NORMAL_95 * _formal(fit)[order]
    spread = NORMAL_95 * _over_windows(fit, u, y)[order]
    zeta = values[:, 0]
    wider = np.fmax(formal, spread)
    explained = 1.0 - fit.rss / float(np.sum(np.abs(lines.y) ** 2))
    verdicts = [_judged(zeta[k], wider[k] / NORMAL_95, explained) for k in range(len(order))]
    remarks = () if order else (_nothing(fit, explained),)
    measured, fitted = _responses(fit, lines)
    return ForcedModes(
        frequency=values[:, 1] / (2.0 * np.pi * step),
        damping_ratio=zeta,
        interval=np.column_stack((zeta - wider, zeta + wider)),
        formal_interval=np.column_stack((zeta - formal, zeta + formal)),
        window_interval=np.column_stack((zeta - spread, zeta + spread)),
        strength=np.array([_strength(fit, k) for k in order]),
        explained=explained,
        line=np.angle(lines.z) / (2.0 * np.pi * step),
        measured=measured,
        fitted=fitted,
        verdict=tuple(word for word, _ in verdicts),
        reasons=tuple(reasons for _, reasons in verdicts),
        remarks=remarks,
    )


def _nothing(fit: _Fit, explained: float) -> str:
    """Return why there is no mode."""
    if not len(fit.poles):
        return 'no mode explains any of the response'
    return (
        f'{len(fit.poles)} fitted poles are not modes within the excited band '
        f'({100.0 * explained:.1f} % of the response explained)'
    )


def _responses(fit: _Fit, lines: _Lines) -> tuple[Complex, Complex]:
    """Return the frequency responses to each input, measured and fitted, (l, inputs) each."""
    inputs = lines.u.shape[1]
    phi = _columns(lines, fit.poles)
    source = np.append(
        np.tile(np.arange(inputs + 1), 2 * len(fit.poles)), [*(2 * list(range(inputs))), inputs]
    )
    parts = np.column_stack(
        [phi[:, source == k] @ fit.weights[source == k] for k in range(inputs)]
    )
    with np.errstate(divide='ignore', invalid='ignore'):
        return (parts + fit.residual[:, None]) / lines.u, parts / lines.u


def _inside(pole: Array, turns: Array) -> bool:
    """Say whether a pole is a mode within the excited band."""
    zeta, rate = zeta_and_rate(*pole)
    return bool(turns.min() < rate < turns.max() and 0.0 < zeta < 0.7)


def _strength(fit: _Fit, k: int) -> float:
    inputs = (fit.weights.size - 1 - 2 * len(fit.poles)) // (2 * len(fit.poles) + 2)
    own = fit.weights[2 * (inputs + 1) * k :].reshape(-1)[: 2 * (inputs + 1)]
    a, b = own[:inputs], own[inputs + 1 : -1]
    return float(np.hypot(a, b).max() / -np.expm1(-max(fit.poles[k, 0], 1e-12)))


def _formal(fit: _Fit) -> Array:
    """Return the standard deviations of zeta from the fit."""
    count = 2 * fit.residual.size
    variance = fit.rss / max(count - fit.poles.size - fit.weights.size, 1)
    scale = np.maximum(np.linalg.norm(fit.jacobian, axis=0), 1e-300)
    gram = np.linalg.pinv((fit.jacobian / scale).T @ (fit.jacobian / scale))
    covariance = variance * gram / np.outer(scale, scale)
    return np.array(
        [pole_zeta_deviation(fit.poles[k], covariance, k) for k in range(len(fit.poles))]
    )


def _over_windows(fit: _Fit, u: Array, y: Array) -> Array:
    """Return the standard deviations of the mean of zeta over quarters of the record."""
    parts = [np.array_split(values, WINDOWS) for values in (u, y)]
    rows = []
    for part_u, part_y in zip(*parts, strict=True):
        lines = _excited(part_u - part_u.mean(axis=0), part_y - part_y.mean())
        if lines.z.size > 2 * len(fit.poles) + 4:
            poles = _nonlinear(lines, fit.poles).poles
            rows.append(poles[:, 0] / np.hypot(poles[:, 0], poles[:, 1]))
    if len(rows) < 2:
        return np.full(len(fit.poles), np.nan)
    return np.asarray(np.std(rows, axis=0, ddof=1) / np.sqrt(len(rows)))


def _judged(zeta: float, deviation: float, explained: float) -> tuple[str, tuple[str, ...]]:
    relative = deviation / zeta
    spread = f'standard deviation of the damping ratio is {100.0 * relative:.1f} % of it'
    share = f'{100.0 * explained:.1f} % of the response explained'
    if not relative <= USELESS:
        return NOT_IDENTIFIABLE, (f'{spread}, more than {100.0 * USELESS:.0f} %', share)
    reasons = []
    if relative > WIDEST:
        reasons.append(f'{spread}, more than {100.0 * WIDEST:.0f} %')
    if explained < LEAST_EXPLAINED:
        reasons.append(f'{share}, less than {100.0 * LEAST_EXPLAINED:.0f} %')
    return (DOUBTFUL, tuple(reasons)) if reasons else (GOOD, (spread, share))


def identify_forced(
    path: Path,
    channel: Channel,
    inputs: Sequence[Channel],
    band: tuple[float, float],
    count: int | None,
) -> tuple[Document, Record, ForcedModes]:
    """Identify modes from the response in a recording to inputs that act together.

    Parameters
    ----------
    inputs : sequence of Channel
        What drives it; where they have no topic, it is that of the response.
    band, count
        Of the modes that the verdict is of, as `strongest` takes them.
    """
    reading = read_record(path, channel)
    topic = reading.channel.topic
    sources = [replace(one, topic=one.topic or topic) for one in inputs]
    driving = [read_record(path, one) for one in sources]
    forces, answer = _together(driving, reading)
    found = fit_forced(forces, answer)
    asked = strongest(found.frequency, found.strength, band, count)
    document = {
        'kind': 'forced',
        'source': {**source_of(reading), 'force': ', '.join(one.name for one in sources)},
        'window': {'begin_s': answer.t[0], 'end_s': answer.t[-1]},
        'quality': quality_of(assess(answer)),
        'method': 'rational frequency response at the excited lines, least squares; order by BIC',
        'modes': [
            {
                **mode_values(found, k, OF_MODE),
                'asked': k in asked,
                **mode_values(found, k, ('verdict', 'reasons')),
            }
            for k in range(len(found.frequency))
        ],
        'explained': found.explained,
        'verdict': found.status_of(asked),
        'remarks': found.remarks,
        'reasons': [*found.remarks, *(one for k in asked for one in found.reasons[k])],
    }
    result = dict(plain(document))
    for one in (reading, *driving):
        result = doubted(result, one)
    return result, answer, found


def _together(forces: Sequence[Reading], response: Reading) -> tuple[list[Record], Record]:
    """Return inputs and response on the stamps of the response where all are there."""
    answer = response.record
    shifted = [
        (one.record, one.record.t + (one.origin_ns - response.origin_ns) * 1e-9) for one in forces
    ]
    if not all(np.array_equal(t, answer.t) for _, t in shifted):
        start = max(answer.t[0], *(t[0] for _, t in shifted))
        answer = answer.part(start, min(answer.t[-1], *(t[-1] for _, t in shifted)))
    return [
        Record(answer.t, np.interp(answer.t, t, one.y), one.name, one.unit) for one, t in shifted
    ], answer
