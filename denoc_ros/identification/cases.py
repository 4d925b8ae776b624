"""The cases that the estimators are measured on: synthetic decays drawn from seeds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from denoc_ros.identification.synthetic import Decay, Defects, Truth, synthetic_decay

Draw = np.random.Generator
Drawn = tuple[list[Truth], float, float]  # modes, sample rate [Hz], duration [s]


def _phase(draw: Draw) -> float:
    return float(draw.uniform(0.0, 2.0 * np.pi))


def _book_link(draw: Draw) -> Drawn:
    """The link of the book's sec. 8.2.2: zeta 0.198 and 0.0428."""
    second = Truth(47.7, 0.0428, draw.uniform(0.2, 1.0), _phase(draw))
    return [Truth(7.62, 0.198, 1.0, _phase(draw)), second], 1000.0, 2.0


def _two_links(draw: Draw) -> Drawn:
    """The tips of the book's sec. 8.4: 11.75 and 13.5 Hz."""
    first = Truth(11.75, draw.uniform(0.005, 0.05), 1.0, _phase(draw))
    second = Truth(13.5, draw.uniform(0.005, 0.05), draw.uniform(0.3, 1.0), _phase(draw))
    return [first, second], 500.0, 5.0


def _light(draw: Draw) -> Drawn:
    return [Truth(draw.uniform(2.0, 10.0), draw.uniform(0.001, 0.005), 1.0, _phase(draw))], 200, 20


def _close_pair(draw: Draw) -> Drawn:
    first = Truth(11.50, draw.uniform(0.001, 0.003), 1.0, _phase(draw))
    second = Truth(11.62, draw.uniform(0.001, 0.003), draw.uniform(0.5, 1.0), _phase(draw))
    return [first, second], 200.0, 20.0


def _joint_and_tip(draw: Draw) -> Drawn:
    """Joint and tip of the book's sec. 8.3: 1.1 and 20.5 Hz."""
    first = Truth(1.1, draw.uniform(0.01, 0.05), 1.0, _phase(draw))
    second = Truth(20.5, draw.uniform(0.005, 0.03), draw.uniform(0.1, 0.5), _phase(draw))
    return [first, second], 200.0, 10.0


def _four_modes(draw: Draw) -> Drawn:
    steps = ((2.0, 4.0), (5.0, 10.0), (8.0, 20.0), (10.0, 30.0))
    frequencies = np.cumsum([draw.uniform(*step) for step in steps])
    zetas = np.exp(draw.uniform(np.log(0.005), np.log(0.2), 4))
    modes = [
        Truth(float(f), float(zeta), draw.uniform(0.3, 1.0), _phase(draw))
        for f, zeta in zip(frequencies, zetas, strict=True)
    ]
    return modes, 500.0, 5.0


CASES: dict[str, Callable[[Draw], Drawn]] = {
    "the book's link": _book_link,
    '11.75 and 13.5 Hz': _two_links,
    'zeta 0.1 to 0.5 %': _light,
    '11.50 and 11.62 Hz': _close_pair,
    '1.1 and 20.5 Hz': _joint_and_tip,
    'four modes, 0.5 to 20 %': _four_modes,
}


def draw_decay(
    case: str, snr_db: tuple[float, float], clip: float, draw: np.random.Generator
) -> Decay:
    """Return a decay of a case with a bag's defects.

    Offset up to half, drift up to a tenth of the largest value, 10 % jitter, 5 % of the samples
    lost, a resolution of a quarter to one and a half of the noise.

    Parameters
    ----------
    case : str
        A key of CASES.
    snr_db : (float, float)
        Range that the release's ratio of largest value to noise is drawn from.
    clip : float
        Part of the largest value that is cut off.
    draw : numpy Generator
    """
    modes, rate, duration = CASES[case](draw)
    snr = float(draw.uniform(*snr_db))
    defects = Defects(
        snr_db=snr,
        offset=draw.uniform(-0.5, 0.5),
        drift=draw.uniform(-0.1, 0.1),
        jitter=0.1,
        lost=0.05,
        lsb=10.0 ** (-snr / 20.0) * draw.uniform(0.25, 1.5),
        clip=clip,
    )
    return synthetic_decay(modes, rate, duration, defects, draw)
