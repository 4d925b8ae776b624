"""Figures: labels that a page shows as they are, and curves that end where noise begins."""

from __future__ import annotations

import re

import numpy as np

from denoc_ros.identification.decay.analysis import analyse_decay
from denoc_ros.identification.decay.records import Record
from denoc_ros.identification.pages.identify_signals import _envelopes
from denoc_ros.pages.figures import Curve, Panel, line_figure

T = np.linspace(0.0, 10.0, 1000)


def labels(svg: str) -> list[str]:
    """Return what a figure says, each text element's own."""
    return re.findall(r'<text[^>]*>([^<]+)</text>', svg)


def test_powers_of_ten_are_plain_text() -> None:
    curve = Curve('', 'ink', T, np.exp(-1.5 * T))  # down to 3e-7
    (drawing,) = line_figure([Panel('decay', 'm', [curve], log_y=True)]).drawings
    shown = labels(drawing.svg)
    assert {'10⁻⁶', '10⁻⁴', '10⁻²', '10⁰'} <= set(shown)
    assert '$' not in drawing.svg
    # less than a decade has labels between the powers
    narrow = Curve('', 'ink', T, 2e-3 + 1e-4 * T)
    (drawing,) = line_figure([Panel('decay', 'm', [narrow], log_y=True)]).drawings
    assert '2×10⁻³' in labels(drawing.svg)


def test_a_decay_is_drawn_down_to_the_noise() -> None:
    noise = 1e-4 * np.random.default_rng(1).standard_normal(T.size)
    # e^-60 at the end: an axis down to there would show nothing else
    record = Record(T, np.exp(-6.0 * T) * np.cos(40.0 * T) + noise)
    section = _envelopes(analyse_decay(record, given=True))
    assert section is not None
    for drawing in section.figures[0].drawings:
        powers = [label for label in labels(drawing.svg) if label.startswith('10')]
        assert powers
        assert max(map(len, powers)) < len('10⁻¹⁰'), powers
