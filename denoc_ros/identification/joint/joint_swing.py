"""Friction of a joint from a free swing: significant terms and their values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.special import fdtrc

from denoc_ros.errors import ConfigError, IdentificationError
from denoc_ros.estimation.turns import unwrap_path
from denoc_ros.identification.decay.channel import Channel, Reading, read_record
from denoc_ros.identification.decay.curves import NORMAL_95
from denoc_ros.identification.decay.damped import independent_samples
from denoc_ros.identification.decay.decrement import (
    Convention,
    critical_joint_damping,
    log_decrement,
)
from denoc_ros.identification.decay.modes import DOUBTFUL, GOOD, NOT_IDENTIFIABLE
from denoc_ros.identification.decay.records import Record, assess, doubtful_rate
from denoc_ros.identification.identification_result import doubted, quality_of, source_of
from denoc_ros.identification.joint.swing import (
    MODELS,
    TERMS,
    JointSwing,
    SwingFit,
    Terms,
    refine_friction,
    scout_friction,
    swing_angles,
)
from denoc_ros.output_files import Document, plain
from denoc_ros.settings import optional, setting
from denoc_ros.types import Array

CHANCE = 1e-3  # of keeping a term that is none
SMALLEST_GAIN = 0.05  # that a term must take off a residual which is no white noise
EVIDENCE = 6.0  # twice the log of the likelihoods' ratio: less does not tell two sets apart
MUCH = 0.3  # of the residual: what terms that are not significantly different from zero leave open

Fits = Mapping[Terms, SwingFit]
FEWEST_HALF_SWINGS = 2
AT_REST = 0.01  # of the largest distance from the last value
CYCLES_AT_REST = 1.0
WIDEST = 0.25  # relative standard deviation of a good term
MOST_UNEXPLAINED = 0.05  # of the range
UNITS = dict(zip(TERMS, ('N m s/rad', 'N m', 'N m s^2/rad^2'), strict=True))
UNITS_PER_INERTIA = dict(zip(TERMS, ('1/s', '1/s^2', '1/rad'), strict=True))


def choose_terms(fits: Fits) -> Terms:
    """Return the smallest set of terms that no larger one improves on.

    A larger set counts where all its terms are told from zero. An F test of its ratio must give
    less than 0.1 %, and where the residual is not white noise it must take 5 % off it.
    """
    chosen = min(MODELS[:2], key=lambda terms: fits[terms].rss)
    for count in (2, 3):
        larger = [one for one in MODELS if len(one) == count and not fits[one].unclear]
        if not larger:
            continue
        best = min(larger, key=lambda terms: fits[terms].rss)
        chance, gain = _gain(fits[chosen], fits[best])
        least = 0.0 if fits[best].white else SMALLEST_GAIN
        if chance < CHANCE and gain > least:
            chosen = best
    return chosen


def rejection(terms: Terms, fits: Fits, chosen: Terms) -> str:
    """Return why a set of terms is not the model; '' for the one that is."""
    if terms == chosen:
        return ''
    fit, best = fits[terms], fits[chosen]
    ratio = float(np.sqrt(fit.rss / best.rss)) if best.rss else np.inf
    said = f'leaves {ratio:.2f} times the residual'
    if set(terms) < set(chosen):
        return f'{said} (F test: p = {_gain(fit, best)[0]:.1g})'
    if fit.at_zero:
        return f'{_listed(fit.at_zero)} at zero'
    if fit.unclear:
        return f'{_listed(fit.unclear)} not significantly different from zero; {said}'
    if set(terms) > set(chosen):
        return f'its further terms take {100.0 * max(1.0 - ratio, 0.0):.1f} % off the residual'
    return said


def open_questions(fits: Fits, chosen: Terms) -> list[str]:
    """Return which other sets the swing does not rule out.

    These are larger sets with a much smaller residual whose terms are not significantly different
    from zero, and sets of as many terms with about the same residual.
    """
    found = []
    best = fits[chosen]
    for terms, fit in fits.items():
        less = 1.0 - np.sqrt(fit.rss / max(best.rss, 1e-300))
        if len(terms) == len(chosen) and terms != chosen and not fit.unclear:
            worth = independent_samples(best.residual)
            if worth * np.log(fit.rss / max(best.rss, 1e-300)) < EVIDENCE:
                found.append(f'{" + ".join(terms)} explains the swing about as well')
        if len(terms) > len(chosen) and fit.unclear and less > MUCH:
            found.append(
                f'{" + ".join(terms)} leaves {100.0 * less:.0f} % less, with '
                f'{_listed(fit.unclear)} not significantly different from zero'
            )
    return found


def _listed(terms: Terms) -> str:
    return f'{" and ".join(dict.fromkeys(terms))} term{"s" * (len(terms) > 1)}'


def _gain(small: SwingFit, large: SwingFit) -> tuple[float, float]:
    """Probability that the additional terms are zero, and their reduction of the residual."""
    more = len(large.values) - len(small.values)
    rest = large.residual.size - len(large.values)
    if small.rss == 0.0:
        return 1.0, 0.0
    ratio = (small.rss - large.rss) / more / max(large.rss / rest, 1e-300)
    return float(fdtrc(more, rest, max(ratio, 0.0))), 1.0 - float(np.sqrt(large.rss / small.rss))


@dataclass(frozen=True, eq=False)
class FrictionModel:
    """One set of friction terms fitted to a swing."""

    terms: tuple[str, ...]  # of viscous, coulomb and quadratic
    swing: JointSwing  # everything per inertia
    residual: float  # standard deviation [rad]
    rejected: str  # why it is not the model; empty for the one that is


@dataclass(frozen=True, eq=False)
class JointFit:
    """Friction of a joint."""

    terms: tuple[str, ...]  # the terms that matter
    frequency: float  # of small swings without friction [Hz]
    # [N m s/rad], [N m], [N m s^2/rad^2] where the inertia or the gravity torque was given; else
    # per inertia: [1/s], [1/s^2], [1/rad]. 0 for terms that do not matter.
    viscous: float
    coulomb: float
    quadratic: float
    interval: dict[str, Array]  # (2,) 95 % intervals of the terms that matter, in the same units
    # about the joint [kg m^2]; 1 where neither inertia nor gravity torque was given
    inertia: float
    damping_ratio: float  # of small swings, from the viscous term
    models: tuple[FrictionModel, ...]  # all that were tried, and why they were rejected
    swing: JointSwing  # the chosen one, per inertia
    residual: float  # its residual's standard deviation [rad]
    start: float  # where the swing starts on the record's clock [s]
    large: bool
    verdict: str
    reasons: tuple[str, ...]

    def prediction(self, t: Array) -> Array:
        """Return the fitted angle at times t [rad]."""
        return swing_angles(self.swing, np.asarray(t, float) - self.start, self.large)


def fit_joint(
    record: Record,
    inertia: float | None = None,
    gravity_torque: float | None = None,
    large: bool = True,
) -> JointFit:
    """Fit viscous, Coulomb and quadratic friction to a free swing, and test which matter.

    Parameters
    ----------
    record : Record
        Joint angle [rad], free from the first sample on.
    inertia : float, optional
        About the joint, motor and gears included [kg m^2].
    gravity_torque : float, optional
        Largest torque of gravity, m g l [N m]: gives the inertia from the frequency.
    large : bool
        Gravity's sine over the angle; False: a linear spring.

    Raises
    ------
    IdentificationError
        The record has less than two half swings.

    Notes
    -----
    The equation of motion is integrated, so large angles and stops are exact. A term stays if it
    differs significantly from zero, if an F test at 0.1 % keeps it and, for a residual that is
    not white noise, if it reduces the residual by at least 5 %. For the intervals, correlated
    residuals count as fewer samples.
    """
    start = _start(record)
    moving = _moving(record, start, 0.25)
    starts = scout_friction(moving.t - moving.t[0], moving.y, start, large)
    moving = _moving(record, start, CYCLES_AT_REST)
    fits = refine_friction(moving.t - moving.t[0], moving.y, starts, large)
    chosen = choose_terms(fits)
    fit, count = fits[chosen], moving.t.size
    scale, known = _inertia(fit.swing, inertia, gravity_torque)
    verdict, reasons = _verdict(record, fits, chosen, count)
    if not known:
        reasons.append('coefficients are per inertia: neither inertia nor gravity torque given')
    size = {name: scale * float(getattr(fit.swing, name)) for name in TERMS}
    half = {name: NORMAL_95 * scale * fit.spread(name) for name in chosen}
    return JointFit(
        terms=chosen,
        frequency=float(np.sqrt(abs(fit.swing.stiffness)) / (2.0 * np.pi)),
        viscous=size['viscous'],
        coulomb=size['coulomb'],
        quadratic=size['quadratic'],
        interval={name: size[name] + half[name] * np.array([-1.0, 1.0]) for name in chosen},
        inertia=scale,
        damping_ratio=float(fit.swing.viscous / (2.0 * np.sqrt(abs(fit.swing.stiffness)))),
        models=tuple(
            FrictionModel(
                terms,
                fits[terms].swing,
                float(np.sqrt(fits[terms].rss / count)),
                rejection(terms, fits, chosen),
            )
            for terms in MODELS
        ),
        swing=fit.swing,
        residual=float(np.sqrt(fit.rss / count)),
        start=float(record.t[0]),
        large=large,
        verdict=verdict,
        reasons=tuple(reasons),
    )


def _start(record: Record) -> JointSwing:
    """Return a first guess from crossings of the level that the record comes to rest at."""
    tail = record.y[-max(record.y.size // 8, 2) :]
    rest = float(np.mean(tail))
    away = record.y - rest
    band = max(3.0 * float(tail.std()), 0.02 * float(np.abs(away).max()))
    crossings, side = [], 0.0
    for time, value in zip(record.t, away, strict=True):
        if abs(value) > band and np.sign(value) != side:
            if side:
                crossings.append(float(time))
            side = float(np.sign(value))
    if len(crossings) < FEWEST_HALF_SWINGS:
        raise IdentificationError(
            f'{record.name}: a swing must pass its rest position at least '
            f'{FEWEST_HALF_SWINGS} times, got {len(crossings)}'
        )
    half = float(np.median(np.diff(crossings)))
    few = max(3, int(0.1 * half / record.step))
    slope = np.polyfit(record.t[:few] - record.t[0], record.y[:few], 1)
    stiffness = (np.pi / half) ** 2
    return JointSwing(float(slope[1]), float(slope[0]), rest, stiffness, 0.1 * np.sqrt(stiffness))


def _moving(record: Record, start: JointSwing, cycles: float) -> Record:
    """Return the record up to some cycles after the joint came to rest: the rest says no more."""
    away = np.abs(record.y - record.y[-1])
    last = float(record.t[np.flatnonzero(away > AT_REST * away.max())[-1]])
    return record.part(
        float(record.t[0]), last + cycles * 2.0 * np.pi / float(np.sqrt(start.stiffness))
    )


def _inertia(
    swing: JointSwing, inertia: float | None, gravity_torque: float | None
) -> tuple[float, bool]:
    if inertia is not None:
        return inertia, True
    if gravity_torque is not None:
        return gravity_torque / swing.stiffness, True
    return 1.0, False


def _verdict(
    record: Record, fits: dict[Terms, SwingFit], chosen: Terms, count: int
) -> tuple[str, list[str]]:
    fit = fits[chosen]
    if fit.unclear:
        return NOT_IDENTIFIABLE, [
            f'{name} term is not significantly different from zero' for name in fit.unclear
        ]
    reasons = []
    left = float(np.sqrt(fit.rss / count)) / float(np.ptp(record.y))
    if left > MOST_UNEXPLAINED:
        reasons.append(f'{100.0 * left:.1f} % of the range is left unexplained')
    for name in chosen:
        relative = fit.spread(name) / getattr(fit.swing, name)
        if relative > WIDEST:
            reasons.append(
                f'standard deviation of the {name} term is {100.0 * relative:.0f} % of it, more '
                f'than {100.0 * WIDEST:.0f} %'
            )
    reasons += open_questions(fits, chosen)
    if doubt := doubtful_rate(record):
        reasons.append(doubt)
    return (DOUBTFUL if reasons else GOOD), reasons


@dataclass(frozen=True)
class JointOptions:
    """Known numbers of a joint that swings; each field is an option of `denoc identify joint`."""

    inertia: float | None = optional(
        float,
        'inertia about the joint, with motor and gears',
        'kg m^2',
        positive=True,
        finite=True,
    )
    gravity_torque: float | None = optional(
        float,
        'largest gravity torque, m g l: with it the frequency gives the inertia',
        'N m',
        positive=True,
        finite=True,
    )
    mass_per_length: float | None = optional(
        float, "for the book's coefficient", 'kg/m', positive=True, finite=True
    )
    length: float | None = optional(
        float, "for the book's coefficient", 'm', positive=True, finite=True
    )
    spring: bool = setting(False, 'the restoring torque is a linear spring, not gravity')


def identify_joint(
    path: Path, channel: Channel, options: JointOptions
) -> tuple[Document, Record, JointFit]:
    """Fit viscous, Coulomb and quadratic friction to a free swing at large angle.

    Report which of them are significant, and give the logarithmic decrement, exact and as printed
    in the book.

    Returns
    -------
    tuple
        The friction as plain values, the record and the fit.

    Raises
    ------
    ConfigError, BagError, IdentificationError
    """
    inertia, torque = options.inertia, options.gravity_torque
    if inertia is not None and torque is not None:
        finding = '--gravity-torque must not come with --inertia, got both'
        ConfigError.raise_any('command line', [finding])
    reading = _unwrapped(read_record(path, channel))
    fit = fit_joint(reading.record, inertia, torque, not options.spring)
    return doubted(_result(reading, fit, options), reading), reading.record, fit


def _unwrapped(reading: Reading) -> Reading:
    """Return a record of a joint without jumps by a turn: it may hang at half a turn."""
    record = reading.record
    angles = unwrap_path(record.t, record.y[:, None], np.ones(1, dtype=bool))[:, 0]
    return replace(reading, record=replace(record, y=angles))


def _result(reading: Reading, fit: JointFit, options: JointOptions) -> Document:
    """Return the friction of a joint as plain values."""
    known = options.inertia is not None or options.gravity_torque is not None
    units = UNITS if known else UNITS_PER_INERTIA
    document = {
        'kind': 'joint',
        'source': source_of(reading),
        'window': {'begin_s': reading.record.t[0], 'end_s': reading.record.t[-1]},
        'quality': quality_of(assess(reading.record)),
        'method': 'equation of motion integrated, least squares; terms kept by F test',
        'terms': {
            name: {
                'value': getattr(fit, name),
                'interval': fit.interval[name],
                'unit': units[name],
            }
            for name in fit.terms
        },
        'frequency_hz': fit.frequency,
        'damping_ratio': fit.damping_ratio,
        'inertia_kg_m2': fit.inertia if known else None,
        'residual': fit.residual,
        'models': [
            {'terms': model.terms, 'residual': model.residual, 'rejected': model.rejected}
            for model in fit.models
        ],
        'decrement': [
            _decrement(reading.record, 'exact', fit.inertia if known else None),
            _decrement(reading.record, 'book', None, options.mass_per_length, options.length),
        ],
        'verdict': fit.verdict,
        'reasons': fit.reasons,
    }
    return dict(plain(document))


def _decrement(
    record: Record,
    convention: Convention,
    inertia: float | None,
    mass_per_length: float | None = None,
    length: float | None = None,
) -> Document:
    """Return the log decrement, with the damping coefficient where its numbers are known."""
    row: Document = {
        'convention': convention,
        'damping_ratio': None,
        'frequency_hz': None,
        'critical': None,
        'coefficient': None,
        'unit': 'N m s/rad' if convention == 'exact' else 'kg/s',
        'reason': '',
    }
    try:
        found = log_decrement(record, convention)
    except IdentificationError as error:
        return {**row, 'reason': str(error)}
    row |= {'damping_ratio': found.damping_ratio, 'frequency_hz': found.frequency}
    if inertia is not None or None not in (mass_per_length, length):
        row['critical'] = critical_joint_damping(
            found.frequency, inertia, mass_per_length, length, convention
        )
        row['coefficient'] = row['critical'] * found.damping_ratio
    return row
