"""From the damped cosines of a fit to modes: pairs that are one, lines, deviations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from denoc_ros.identification.curves import (
    amplitude_curve,
    between_windows,
    zeta_and_rate,
    zeta_deviation,
)
from denoc_ros.identification.damped import Damped, columns, fit_damped
from denoc_ros.identification.lines import find_lines
from denoc_ros.identification.modes import AmplitudeCurve, Line
from denoc_ros.identification.records import Floats

CYCLES = 0.75  # in the record: less is part of the drift


@dataclass(frozen=True, eq=False)
class Component:
    """One mode with its deviations (standard deviations of zeta) and its decay without the rest.

    `formal` is from the fit, `windowed` adds the spread between windows, `deviation` is the one
    to go by, `bound` the Cramer-Rao bound relative to zeta.
    """

    frequency: float
    zeta: float
    amplitude: float
    phase: float
    formal: float
    windowed: float
    deviation: float
    bound: float
    frequency_deviation: float
    snr_db: float
    curve: AmplitudeCurve | None
    merged: int


def components(t: Floats, fit: Damped, span: float) -> tuple[list[Component], tuple[Line, ...]]:
    """Return the modes of a fit by rising frequency, and the components that are none.

    Parameters
    ----------
    t : ndarray, shape (k,)
        Times of the fitted samples from the start of the record [s].
    fit : Damped
    span : float
        Duration of the record [s].
    """
    lines = find_lines(fit, span)
    slow = fit.poles[:, 1] * span < 2.0 * np.pi * CYCLES
    kept = [k for k in range(len(fit.poles)) if k not in lines and not slow[k]]
    kept.sort(key=lambda k: float(np.hypot(*fit.poles[k])))
    parts = [_component(t, fit, group, span) for group in _groups(fit, kept, span)]
    return parts, tuple(lines.values())


def _groups(fit: Damped, kept: list[int], span: float) -> list[list[int]]:
    """Put together what one over the duration does not tell apart."""
    groups: list[list[int]] = []
    for k in kept:
        near = groups and (fit.poles[k, 1] - fit.poles[groups[-1][-1], 1]) < 2.0 * np.pi / span
        if near:
            groups[-1].append(k)
        else:
            groups.append([k])
    return groups


def _component(t: Floats, fit: Damped, group: list[int], span: float) -> Component:
    phi = columns(t, fit.poles[group], span)[:, :-2]
    chosen = [2 * k + part for k in group for part in (0, 1)]
    own = fit.residual + phi @ fit.weights[chosen]
    size = np.abs(fit.complex_amplitudes[group])
    index = group[int(np.argmax(size))]
    alone, place = fit, index
    if len(group) > 1:
        alone, place = fit_damped(t, own, fit.poles[[index]]), 0
    sigma, omega = alone.poles[place]
    zeta, rate = zeta_and_rate(sigma, omega)
    value = alone.complex_amplitudes[place]
    noise = float(np.sqrt(fit.variance))
    formal = zeta_deviation(alone, place)
    curve = amplitude_curve(t, own, sigma, omega, abs(value), noise)
    windowed = float(np.hypot(formal, between_windows(curve))) if curve else np.nan
    deviation = windowed if curve and curve.dependent else formal
    return Component(
        frequency=rate / (2.0 * np.pi),
        zeta=zeta,
        amplitude=float(abs(value)),
        phase=float(np.angle(value)),
        formal=formal,
        windowed=windowed,
        deviation=deviation,
        bound=formal / abs(zeta) if zeta else np.inf,
        frequency_deviation=_frequency_deviation(alone, place),
        snr_db=20.0 * float(np.log10(abs(value) / (noise * np.sqrt(2.0)))) if noise else np.inf,
        curve=curve,
        merged=len(group),
    )


def _frequency_deviation(fit: Damped, k: int) -> float:
    slope = fit.poles[k] / np.hypot(*fit.poles[k]) / (2.0 * np.pi)
    block = fit.covariance()[2 * k : 2 * k + 2, 2 * k : 2 * k + 2]
    return float(np.sqrt(max(slope @ block @ slope, 0.0)))
