"""Sets of friction terms fitted to one free swing, each from several starts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from denoc_ros.identification.residual import coloured, independent_samples
from denoc_ros.identification.swing import STEPS_PER_CYCLE, JointSwing, swing_angles
from denoc_ros.types import Array

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


@dataclass(frozen=True, eq=False)
class SwingFit:
    """One set of friction terms, fitted to a swing.

    Attributes
    ----------
    terms : tuple of str
        Of viscous, coulomb and quadratic.
    values : ndarray, shape (4 + terms,)
        Angle, rate, rest, stiffness and the terms, as in `Swing`.
    deviation : ndarray, shape (4 + terms,)
        Standard deviations, residuals that hang together counted as fewer samples; inf where the
        swing does not determine a value.
    residual : ndarray, shape (k,)
        Measured minus simulated [rad].
    at_zero : tuple of str
        Terms that the fit put at their bound, 0.
    """

    terms: Terms
    values: Array
    deviation: Array
    residual: Array
    at_zero: Terms

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
    large : bool
        Gravity's sine; False: a linear spring.
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
    t: Array,
    y: Array,
    start: JointSwing,
    terms: Terms,
    large: bool,
    steps: int = STEPS_PER_CYCLE,
) -> SwingFit:
    """Fit one set of friction terms from one start: the equation of motion is integrated.

    Parameters
    ----------
    t, y : ndarray, shape (k,)
        Times from the start of the swing [s], measured angles [rad].
    start : JointSwing
    terms : tuple of str
        Of viscous, coulomb and quadratic.
    large : bool
        Gravity's sine; False: a linear spring.
    steps : int
        Of the integration, per cycle.
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
