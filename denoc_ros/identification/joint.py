"""Friction of a joint from a free swing: which terms matter, and how large they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import f as fisher

from denoc_ros.errors import IdentificationError
from denoc_ros.identification.curves import NORMAL_95
from denoc_ros.identification.modes import DOUBTFUL, GOOD, NOT_IDENTIFIABLE
from denoc_ros.identification.records import Floats, Record
from denoc_ros.identification.residual import coloured, independent_samples
from denoc_ros.identification.swing import Swing, swing_angles

TERMS = ('viscous', 'coulomb', 'quadratic')
MODELS: tuple[tuple[str, ...], ...] = (('viscous',), ('coulomb',), ('viscous', 'coulomb'), TERMS)
CHANCE = 1e-3  # of keeping a term that is none
SMALLEST_GAIN = 0.05  # that a term must take off a residual which is no white noise
FEWEST_HALF_SWINGS = 2
AT_REST = 0.01  # of the largest distance from the last value
CYCLES_AT_REST = 1.0
FRICTION_STARTS = (0.005, 0.04, 0.15)  # of what holds the joint at its largest angle


@dataclass(frozen=True, eq=False)
class FrictionModel:
    """One set of friction terms fitted to a swing.

    Attributes
    ----------
    terms : tuple of str
        Of viscous, coulomb and quadratic.
    swing : Swing
        Everything per inertia.
    residual : float
        Standard deviation [rad].
    rejected : str
        Why it is not the model; empty for the one that is.
    """

    terms: tuple[str, ...]
    swing: Swing
    residual: float
    rejected: str


@dataclass(frozen=True, eq=False)
class JointFit:
    """Friction of a joint.

    Attributes
    ----------
    terms : tuple of str
        The terms that matter.
    frequency : float
        Of small swings without friction [Hz].
    viscous, coulomb, quadratic : float
        [N m s/rad], [N m], [N m s^2/rad^2] where the inertia or the gravity torque was given;
        else per inertia: [1/s], [1/s^2], [1/rad]. 0 for terms that do not matter.
    interval : dict of str to ndarray, shape (2,)
        95 % intervals of the terms that matter, in the same units.
    inertia : float
        About the joint [kg m^2]; 1 where neither inertia nor gravity torque was given.
    damping_ratio : float
        Of small swings, from the viscous term.
    models : tuple of FrictionModel
        All that were tried, and why they were rejected.
    swing : Swing
        The chosen one, per inertia.
    residual : float
        Its residual's standard deviation [rad].
    start : float
        Where the swing starts on the record's clock [s].
    verdict : str
    reasons : tuple of str
    """

    terms: tuple[str, ...]
    frequency: float
    viscous: float
    coulomb: float
    quadratic: float
    interval: dict[str, Floats]
    inertia: float
    damping_ratio: float
    models: tuple[FrictionModel, ...]
    swing: Swing
    residual: float
    start: float
    large: bool
    verdict: str
    reasons: tuple[str, ...]

    def prediction(self, t: Floats) -> Floats:
        """Return the fitted angle at times t [rad]."""
        return swing_angles(self.swing, np.asarray(t, float) - self.start, self.large)


@dataclass(frozen=True, eq=False)
class _Fit:
    values: Floats
    covariance: Floats
    residual: Floats
    free: tuple[str, ...]

    @property
    def rss(self) -> float:
        """Sum of squared residuals."""
        return float(self.residual @ self.residual)

    @property
    def white(self) -> bool:
        """Neighbouring residuals are independent."""
        return not coloured(self.residual)


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
    The equation of motion is integrated, so large angles and stops are as they are. A term stays
    if an F test at 0.1 % keeps it, and where the residual is no white noise, it takes at least 5 %
    off it. For the intervals, residuals that hang together count as fewer samples.
    """
    start = _start(record)
    moving = _moving(record, start, 0.25)
    fits = _fitted(moving.t - moving.t[0], moving.y, start, large)
    moving = _moving(record, start, CYCLES_AT_REST)
    t = moving.t - moving.t[0]
    fits = {
        terms: _least_squares(t, moving.y, fit.values, fit.free, _scale(moving.y, start), large)
        for terms, fit in fits.items()
    }
    chosen = _chosen(fits)
    models = tuple(_model(terms, fits, chosen, t.size) for terms in MODELS)
    fit = fits[chosen]
    swing = _swing(fit)
    scale, known = _inertia(swing, inertia, gravity_torque)
    reasons = _reasons(record, fit, chosen)
    at = {name: k for k, name in enumerate(fit.free)}
    spread = {
        name: NORMAL_95 * scale * float(np.sqrt(fit.covariance[at[name], at[name]]))
        for name in chosen
    }
    size = {name: scale * float(getattr(swing, name)) for name in TERMS}
    useless = [name for name in chosen if spread[name] > abs(size[name])]
    reasons += [f'{name} term is not told from zero' for name in useless]
    verdict = GOOD if not reasons else NOT_IDENTIFIABLE if useless else DOUBTFUL
    if not known:
        reasons.append('coefficients are per inertia: neither inertia nor gravity torque given')
    return JointFit(
        terms=chosen,
        frequency=float(np.sqrt(abs(swing.stiffness)) / (2.0 * np.pi)),
        viscous=size['viscous'],
        coulomb=size['coulomb'],
        quadratic=size['quadratic'],
        interval={
            name: np.array([size[name] - spread[name], size[name] + spread[name]])
            for name in chosen
        },
        inertia=scale,
        damping_ratio=float(swing.viscous / (2.0 * np.sqrt(abs(swing.stiffness)))),
        models=models,
        swing=swing,
        residual=float(np.sqrt(fit.rss / t.size)),
        start=float(record.t[0]),
        large=large,
        verdict=verdict,
        reasons=tuple(reasons),
    )


def _start(record: Record) -> Swing:
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
    return Swing(float(slope[1]), float(slope[0]), rest, stiffness, 0.1 * np.sqrt(stiffness))


def _moving(record: Record, start: Swing, cycles: float) -> Record:
    """Return the record up to some cycles after the joint came to rest: the rest says no more."""
    away = np.abs(record.y - record.y[-1])
    last = float(record.t[np.flatnonzero(away > AT_REST * away.max())[-1]])
    return record.part(
        float(record.t[0]), last + cycles * 2.0 * np.pi / float(np.sqrt(start.stiffness))
    )


def _fitted(t: Floats, y: Floats, guess: Swing, large: bool) -> dict[tuple[str, ...], _Fit]:
    """Fit all sets of terms, the larger ones from the smaller ones' values.

    Several starts of the new term: where friction stops the joint, a fit gets caught.
    """
    fits: dict[tuple[str, ...], _Fit] = {}
    for terms in MODELS:
        known = _swing(fits[terms[:-1]]) if terms[:-1] in fits else guess
        tried = [_fitted_from(t, y, known, terms, large, part) for part in FRICTION_STARTS]
        fits[terms] = min(tried, key=lambda fit: fit.rss)
    return fits


def _fitted_from(
    t: Floats, y: Floats, guess: Swing, terms: tuple[str, ...], large: bool, part: float
) -> _Fit:
    free = ('angle', 'rate', 'rest', 'stiffness', *terms)
    scale = _scale(y, guess)
    start = np.array([getattr(guess, name) or part * scale[name] for name in free])
    start[-1] = part * scale[terms[-1]]
    return _least_squares(t, y, start, free, scale, large)


def _scale(y: Floats, guess: Swing) -> dict[str, float]:
    reach = float(np.abs(y - guess.rest).max())
    rate = float(np.sqrt(guess.stiffness))
    return {
        'angle': reach,
        'rate': reach * rate,
        'rest': reach,
        'stiffness': guess.stiffness,
        'viscous': rate,
        'coulomb': guess.stiffness * reach,
        'quadratic': 1.0 / reach,
    }


def _least_squares(
    t: Floats,
    y: Floats,
    start: Floats,
    free: tuple[str, ...],
    scale: dict[str, float],
    large: bool,
) -> _Fit:
    low = [0.0 if name in (*TERMS, 'stiffness') else -np.inf for name in free]

    def residuals(values: Floats) -> Floats:
        return y - swing_angles(Swing(**dict(zip(free, values.tolist(), strict=True))), t, large)

    found = least_squares(
        residuals,
        start,
        bounds=(low, np.inf),
        x_scale=[scale[name] for name in free],
        diff_step=1e-6,
        xtol=1e-8,
        ftol=1e-8,
        max_nfev=60,
    )
    size = np.linalg.norm(found.jac, axis=0)
    size[size == 0.0] = 1.0
    gram = np.linalg.pinv((found.jac / size).T @ (found.jac / size)) / np.outer(size, size)
    freedom = max(independent_samples(found.fun) - len(free), len(free))
    return _Fit(found.x, found.fun @ found.fun / freedom * gram, found.fun, free)


def _swing(fit: _Fit) -> Swing:
    return Swing(**dict(zip(fit.free, fit.values.tolist(), strict=True)))


def _gain(small: _Fit, large: _Fit) -> tuple[float, float]:
    """Return the chance that the terms more are none, and what they take off the residual."""
    more = len(large.free) - len(small.free)
    rest = large.residual.size - len(large.free)
    ratio = (small.rss - large.rss) / more / max(large.rss / rest, 1e-300)
    chance = float(fisher.sf(max(ratio, 0.0), more, rest))
    return chance, 1.0 - float(np.sqrt(large.rss / small.rss))


def _chosen(fits: dict[tuple[str, ...], _Fit]) -> tuple[str, ...]:
    """Return the smallest set of terms that no larger one improves on."""
    chosen = min(MODELS[:2], key=lambda terms: fits[terms].rss)
    for larger in MODELS[2:]:
        chance, gain = _gain(fits[chosen], fits[larger])
        least = 0.0 if fits[larger].white else SMALLEST_GAIN
        if chance < CHANCE and gain > least:
            chosen = larger
    return chosen


def _model(
    terms: tuple[str, ...], fits: dict[tuple[str, ...], _Fit], chosen: tuple[str, ...], count: int
) -> FrictionModel:
    fit, best = fits[terms], fits[chosen]
    rejected = ''
    if terms != chosen:
        ratio = np.sqrt(fit.rss / best.rss)
        if len(terms) < len(chosen):
            chance = _gain(fit, best)[0]
            rejected = f'leaves {ratio:.2f} times the residual (F test: p = {chance:.1g})'
        else:
            rejected = f'its further terms take {100.0 * (1.0 - ratio):.1f} % off the residual'
            if len(terms) == len(chosen):
                rejected = f'leaves {ratio:.2f} times the residual'
    return FrictionModel(terms, _swing(fit), float(np.sqrt(fit.rss / count)), rejected)


def _inertia(
    swing: Swing, inertia: float | None, gravity_torque: float | None
) -> tuple[float, bool]:
    if inertia is not None:
        return inertia, True
    if gravity_torque is not None:
        return gravity_torque / swing.stiffness, True
    return 1.0, False


def _reasons(record: Record, fit: _Fit, chosen: tuple[str, ...]) -> list[str]:
    reasons = []
    reach = float(np.ptp(record.y))
    left = np.sqrt(fit.rss / record.t.size) / reach
    if left > 0.05:
        reasons.append(f'{100.0 * left:.1f} % of the range is left unexplained')
    return reasons
