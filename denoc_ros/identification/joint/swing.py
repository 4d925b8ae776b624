"""Free swing of a joint under gravity or a spring, with viscous and Coulomb friction."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import copysign, sin

import numpy as np
from scipy.optimize import least_squares

from denoc_ros.identification.decay.damped import coloured, independent_samples
from denoc_ros.types import Array

STEPS_PER_CYCLE = 60
Terms = tuple[str, ...]

TERMS = ('viscous', 'coulomb', 'quadratic')
# by number of terms: a larger set starts from the smaller ones' values
MODELS: tuple[Terms, ...] = (
    ('viscous',),
    ('coulomb',),
    ('viscous', 'coulomb'),
    ('viscous', 'quadratic'),
    ('coulomb', 'quadratic'),
    TERMS,
)
MOTION = ('angle', 'rate', 'rest', 'stiffness')
STARTS = (0.005, 0.04, 0.15)  # of what holds the joint at its largest angle
SCOUT_STEPS = STEPS_PER_CYCLE // 2  # of the integration while starts are compared
NO_TERM = 1e-4  # of what holds the joint at its largest angle: less is no friction
SINGULAR = 1e-9  # of the largest singular value: a direction that the swing does not determine


@dataclass(frozen=True)
class JointSwing:
    """Parameters of a free swing: everything per inertia.

    th'' + viscous th' + quadratic |th'| th' + coulomb sign th' + stiffness sin(th) = 0, th from
    the rest position.
    """

    # at the start [rad], [rad/s]
    angle: float
    rate: float
    rest: float  # measured angle at which gravity is in balance [rad]
    stiffness: float  # [1/s^2]
    # [1/s], [1/s^2], [1/rad]
    viscous: float = 0.0
    coulomb: float = 0.0
    quadratic: float = 0.0


def swing_angles(
    swing: JointSwing, t: Array, large: bool = True, steps: int = STEPS_PER_CYCLE
) -> Array:
    """Return the measured angle at times t from the start [rad].

    Parameters
    ----------
    t : ndarray, shape (k,)
        From 0, rising [s].
    large : bool
        Gravity's sine; False: a linear spring.
    steps : int
        Of the integration, per cycle of a small swing.

    Notes
    -----
    Runge-Kutta steps of fourth order between turning points, which are found (friction jumps
    there); at one the joint stays where friction holds it.
    """
    step = 2.0 * np.pi / np.sqrt(abs(swing.stiffness) + 1e-12) / steps
    step = min(step, float(t[-1]) / 10.0)
    times, angles, rates = _path(swing, float(t[-1]) + step, step, large)
    return np.asarray(swing.rest + _hermite(times, angles, rates, t))


def _path(swing: JointSwing, end: float, step: float, large: bool) -> tuple[Array, Array, Array]:
    time, angle, rate = 0.0, swing.angle - swing.rest, swing.rate
    rows = [(time, angle, rate)]
    side = copysign(1.0, rate if rate else -angle)
    while time < end:
        if rate == 0.0:
            pull = -swing.stiffness * (sin(angle) if large else angle)
            if abs(pull) <= swing.coulomb:
                rows.append((end, angle, 0.0))
                break
            side = copysign(1.0, pull)
        slope = _acceleration(swing, side, large)
        new_angle, new_rate = _step(slope, angle, rate, step)
        taken = step
        if new_rate * side < 0.0:
            taken = _turning(slope, angle, rate, step)
            new_angle, new_rate = _step(slope, angle, rate, taken)[0], 0.0
        time, angle, rate = time + taken, new_angle, new_rate
        rows.append((time, angle, rate))
    table = np.array(rows)
    return table[:, 0], table[:, 1], table[:, 2]


def _acceleration(swing: JointSwing, side: float, large: bool) -> Callable[[float, float], float]:
    stiffness, viscous = swing.stiffness, swing.viscous
    quadratic, coulomb = side * swing.quadratic, side * swing.coulomb
    if large:
        return lambda a, r: -stiffness * sin(a) - viscous * r - quadratic * r * r - coulomb
    return lambda a, r: -stiffness * a - viscous * r - quadratic * r * r - coulomb


def _step(
    slope: Callable[[float, float], float], angle: float, rate: float, h: float
) -> tuple[float, float]:
    r1, s1 = rate, slope(angle, rate)
    r2 = rate + 0.5 * h * s1
    s2 = slope(angle + 0.5 * h * r1, r2)
    r3 = rate + 0.5 * h * s2
    s3 = slope(angle + 0.5 * h * r2, r3)
    r4 = rate + h * s3
    s4 = slope(angle + h * r3, r4)
    return angle + h / 6.0 * (r1 + 2.0 * (r2 + r3) + r4), rate + h / 6.0 * (
        s1 + 2.0 * (s2 + s3) + s4
    )


def _turning(slope: Callable[[float, float], float], angle: float, rate: float, h: float) -> float:
    """Return the time within a step at which the rate is zero."""
    low, high = 0.0, h
    at_low, at_high = rate, _step(slope, angle, rate, h)[1]
    middle = h
    for _ in range(30):
        middle = high - at_high * (high - low) / (at_high - at_low)
        at = _step(slope, angle, rate, middle)[1]
        if abs(at) <= 1e-13 * max(abs(rate), abs(at_high), 1e-9):
            break
        if at * rate > 0.0:
            low, at_low = middle, at
            at_high *= 0.5
        else:
            high, at_high = middle, at
            at_low *= 0.5
    return max(middle, 1e-12)


def _hermite(times: Array, angles: Array, rates: Array, t: Array) -> Array:
    k = np.clip(np.searchsorted(times, t, side='right') - 1, 0, times.size - 2)
    h = times[k + 1] - times[k]
    x = (t - times[k]) / h
    return np.asarray(
        angles[k] * (1.0 + 2.0 * x) * (1.0 - x) ** 2
        + angles[k + 1] * x**2 * (3.0 - 2.0 * x)
        + h * (rates[k] * x * (1.0 - x) ** 2 - rates[k + 1] * x**2 * (1.0 - x))
    )


@dataclass(frozen=True, eq=False)
class SwingFit:
    """One set of friction terms, fitted to a swing."""

    terms: Terms  # of viscous, coulomb and quadratic
    values: Array  # (4 + terms,) angle, rate, rest, stiffness and the terms, as in `Swing`
    # (4 + terms,) standard deviations, residuals that hang together counted as fewer samples; inf
    # where the swing does not determine a value
    deviation: Array
    residual: Array  # (k,) measured minus simulated [rad]
    at_zero: Terms  # terms that the fit put at their bound, 0

    @property
    def rss(self) -> float:
        """Sum of squared residuals."""
        return float(self.residual @ self.residual)

    @property
    def white(self) -> bool:
        """Neighbouring residuals are independent."""
        return not coloured(self.residual)

    @property
    def swing(self) -> JointSwing:
        """The swing it is, per inertia."""
        return JointSwing(**dict(zip((*MOTION, *self.terms), self.values.tolist(), strict=True)))

    def spread(self, term: str) -> float:
        """Return the standard deviation of a term, inf where it is not determined."""
        return float(self.deviation[len(MOTION) + self.terms.index(term)])

    @property
    def unclear(self) -> Terms:
        """The terms whose interval of two standard deviations contains zero."""
        return tuple(
            name
            for name in self.terms
            if name in self.at_zero or not 2.0 * self.spread(name) < getattr(self.swing, name)
        )


def scout_friction(t: Array, y: Array, guess: JointSwing, large: bool) -> dict[Terms, JointSwing]:
    """Return the best of several starts for each set of terms.

    Friction stops the joint, and there a fit is caught. So each new term starts from several
    values, and each set from every smaller set's solution.

    Parameters
    ----------
    t, y : ndarray, shape (k,)
        Times from the start of the swing [s], measured angles [rad].
    guess : JointSwing
        First guess of the motion; its friction is not used.
    """
    found: dict[Terms, tuple[float, JointSwing]] = {}
    for terms in MODELS:
        tried = []
        for start in _starts(guess, terms, found, _scale(y, guess)):
            fit = fit_swing(t, y, start, terms, large, SCOUT_STEPS)
            tried.append((fit.rss, fit.swing))
        found[terms] = min(tried, key=lambda one: one[0])
    return {terms: swing for terms, (_, swing) in found.items()}


def refine_friction(
    t: Array, y: Array, starts: dict[Terms, JointSwing], large: bool
) -> dict[Terms, SwingFit]:
    """Fit each set of terms from its start, and from the smaller sets where that is better.

    A larger set never leaves more than one that it contains: with its further terms at 0 it is
    the smaller one.
    """
    fits: dict[Terms, SwingFit] = {}
    for terms in MODELS:
        fit = fit_swing(t, y, starts[terms], terms, large)
        for smaller in _within(terms, fits):
            if fits[smaller].rss < fit.rss:
                again = fit_swing(t, y, fits[smaller].swing, terms, large)
                fit = min((fit, again, _padded(fits[smaller], terms)), key=lambda one: one.rss)
        fits[terms] = fit
    return fits


def fit_swing(
    t: Array, y: Array, start: JointSwing, terms: Terms, large: bool, steps: int = STEPS_PER_CYCLE
) -> SwingFit:
    """Fit one set of friction terms from one start: the equation of motion is integrated.

    Parameters
    ----------
    t, y : ndarray, shape (k,)
        Times from the start of the swing [s], measured angles [rad].
    terms : tuple of str
        Of viscous, coulomb and quadratic.
    """
    free = (*MOTION, *terms)
    scale = _scale(y, start)

    def residuals(values: Array) -> Array:
        swing = JointSwing(**dict(zip(free, values.tolist(), strict=True)))
        return y - swing_angles(swing, t, large, steps)

    found = least_squares(
        residuals,
        np.array([getattr(start, name) for name in free]),
        bounds=([0.0 if name in (*TERMS, 'stiffness') else -np.inf for name in free], np.inf),
        x_scale=[scale[name] for name in free],
        diff_step=1e-6,
        xtol=1e-8,
        ftol=1e-8,
        max_nfev=60 if steps == STEPS_PER_CYCLE else 25,
    )
    at_zero = tuple(
        name
        for name, value in zip(free, found.x, strict=True)
        if name in TERMS and value < NO_TERM * scale[name]
    )
    return SwingFit(terms, found.x, _deviation(found.jac, found.fun), found.fun, at_zero)


def _starts(
    guess: JointSwing,
    terms: Terms,
    found: dict[Terms, tuple[float, JointSwing]],
    scale: dict[str, float],
) -> list[JointSwing]:
    smaller = _within(terms, found)
    if not smaller:
        return [_with(guess, terms[0], part * scale[terms[0]]) for part in STARTS]
    best = min(smaller, key=lambda one: found[one][0])
    starts = []
    for one in smaller:
        (new,) = (name for name in terms if name not in one)
        parts = STARTS if one == best else STARTS[:1]
        starts += [_with(found[one][1], new, part * scale[new]) for part in parts]
    return starts


def _with(swing: JointSwing, term: str, value: float) -> JointSwing:
    return JointSwing(**{**vars(swing), term: value})


def _within(terms: Terms, known: Iterable[Terms]) -> list[Terms]:
    """Return the known sets that have one term less."""
    return [one for one in known if len(one) == len(terms) - 1 and set(one) < set(terms)]


def _padded(fit: SwingFit, terms: Terms) -> SwingFit:
    """Return a smaller set's fit as one of a larger set, whose further terms are at 0."""
    free = (*MOTION, *terms)
    pairs_of = zip(fit.values, fit.deviation, strict=True)
    known = dict(zip((*MOTION, *fit.terms), pairs_of, strict=True))
    pairs = np.array([known.get(name, (0.0, np.inf)) for name in free])
    new = tuple(name for name in terms if name not in fit.terms)
    return SwingFit(terms, pairs[:, 0], pairs[:, 1], fit.residual, (*fit.at_zero, *new))


def _scale(y: Array, guess: JointSwing) -> dict[str, float]:
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


def _deviation(jacobian: Array, residual: Array) -> Array:
    """Standard deviations; inf for parameters that the samples do not determine."""
    size = np.linalg.norm(jacobian, axis=0)
    unseen = size == 0.0
    _, singular, rows = np.linalg.svd(jacobian / np.where(unseen, 1.0, size), full_matrices=False)
    known = singular > SINGULAR * singular[0]
    gram = np.sum((rows[known] / singular[known, None]) ** 2, axis=0)
    lost = unseen | (np.sum(rows[~known] ** 2, axis=0) > SINGULAR)
    freedom = max(independent_samples(residual) - size.size, float(size.size))
    deviation = np.sqrt(residual @ residual / freedom * gram) / np.where(unseen, 1.0, size)
    return np.where(lost, np.inf, deviation)
