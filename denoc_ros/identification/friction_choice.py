"""Selection of the friction terms of a swing, with the reasons against the other sets."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.special import fdtrc

from denoc_ros.identification.residual import independent_samples
from denoc_ros.identification.swing_fit import MODELS, SwingFit, Terms

CHANCE = 1e-3  # of keeping a term that is none
SMALLEST_GAIN = 0.05  # that a term must take off a residual which is no white noise
EVIDENCE = 6.0  # twice the log of the likelihoods' ratio: less does not tell two sets apart
MUCH = 0.3  # of the residual: what terms that are not significantly different from zero leave open

Fits = Mapping[Terms, SwingFit]


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
