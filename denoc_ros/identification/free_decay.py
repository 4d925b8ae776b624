"""Whether a component is a free decay: a later start must find it again.

Cosines that decay fast also fit what is no decay at all: an impact, the end of a motion, a filter
that settles. Their poles then depend on where the record starts, those of a mode do not; or
several of them overlap and make up together what none of them is.
"""

from __future__ import annotations

import numpy as np

from denoc_ros.identification.damped import Damped, fit_damped
from denoc_ros.identification.residual import coloured, local_variance
from denoc_ros.types import Array

LATER = 0.5  # time constants
MOST_CYCLES = 1.5
SHORT = 0.15  # of the record: a time constant longer than that is seen for long enough
SURPRISING = 30.0  # squared deviations of two numbers; noise alone passes it once in 3e6
LARGE = 0.25  # of the decay rate
GONE = 0.3  # standard deviations of the noise: a component smaller than that is left out
FEWEST_SAMPLES = 16
HEAVY = 0.05  # damping ratio from which on neighbours are looked at
COMPARABLE = 0.1  # of its amplitude: smaller neighbours do not count


def later_start_differs(t: Array, fit: Damped, span: float, k: int) -> str:
    """Return how a later start moves component k of a fit; '' where it finds the same mode.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times of the fitted samples from the start of the record [s].
    fit : Damped
        Of the whole record.
    span : float
        Duration of the record [s].
    k : int
        Which component.
    """
    sigma, omega = fit.poles[k]
    if sigma <= 0.0 or 1.0 / sigma > SHORT * span:
        return ''
    late = min(LATER / sigma, MOST_CYCLES * 2.0 * np.pi / omega)
    seen = t >= late
    if np.count_nonzero(seen) < FEWEST_SAMPLES + 4 * len(fit.poles):
        return ''
    left = np.abs(fit.complex_amplitudes) * np.exp(-fit.poles[:, 0] * late)
    kept = left > GONE * np.sqrt(fit.variance)
    kept[k] = True
    y = fit.prediction(t) + fit.residual
    again = fit_damped(t[seen] - late, y[seen], fit.poles[kept], span, rounds=12)
    return _difference(t[seen], fit.poles[k], again, int(np.count_nonzero(kept[:k])), late)


def _difference(t: Array, pole: Array, again: Damped, place: int, late: float) -> str:
    found = again.poles[place]
    change = found - pole
    block = slice(2 * place, 2 * place + 2)
    covariance = again.covariance()[block, block] * _excess(t, again, place) ** 2
    covariance += 1e-18 * np.eye(2) * float(pole @ pole)
    distance = float(change @ np.linalg.solve(covariance, change))
    if distance < SURPRISING or np.hypot(*change) < LARGE * pole[0]:
        return ''
    rate = float(np.hypot(*found))
    return (
        f'no free decay from the start of the window: {1e3 * late:.3g} ms later it is '
        f'{rate / (2.0 * np.pi):.4g} Hz with a damping ratio of {found[0] / rate:.3g}'
    )


def _excess(t: Array, fit: Damped, k: int) -> float:
    if not coloured(fit.residual) or fit.variance == 0.0:
        return 1.0
    local = local_variance(t - t[0], fit.residual, float(t[-1] - t[0]), *fit.poles[k])
    return float(np.sqrt(max(local / fit.variance, 1.0)))


def overlapping(poles: Array, size: Array, k: int) -> str:
    """Return which heavily damped neighbour component k overlaps with; '' where there is none.

    Parameters
    ----------
    poles : ndarray, shape (m, 2)
        Decay rates [1/s] and damped angular frequencies [rad/s].
    size : ndarray, shape (m,)
        Amplitudes at the start.
    k : int
        Which component.
    """
    rate = np.hypot(*poles.T)
    heavy = poles[:, 0] > HEAVY * rate
    near = np.abs(rate - rate[k]) < poles[:, 0] + poles[k, 0]
    near &= heavy & (size > COMPARABLE * size[k])
    near[k] = False
    if not (heavy[k] and near.any()):
        return ''
    closest = int(np.argmin(np.where(near, np.abs(rate - rate[k]), np.inf)))
    return (
        f'overlaps with {rate[closest] / (2.0 * np.pi):.4g} Hz, which decays as fast: together '
        'they may be no free decay'
    )
