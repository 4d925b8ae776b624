"""Logarithmic decrement: the book's printed numbers and the exact relations."""

from __future__ import annotations

import numpy as np
import pytest
from book.selftest import Defects, Truth, synthetic_decay
from scipy.interpolate import PchipInterpolator

import denoc_ros as dn
from denoc_ros.identification.decay.decrement import (
    critical_joint_damping,
    damping_ratio,
    log_decrement,
)
from denoc_ros.identification.decay.records import Record


def test_book_convention_gives_the_printed_joint_coefficient() -> None:
    critical = critical_joint_damping(0.96, mass_per_length=0.5455, length=0.33, convention='book')
    # table 8.1 and sec. 8.2.1: four and three printed digits
    assert critical == pytest.approx(2.1716, abs=5e-5)
    assert 0.0142 * critical == pytest.approx(0.0308, abs=5e-5)


def test_consistent_coefficient_is_that_of_the_torque_equation() -> None:
    inertia, rate, zeta = 0.0065, 6.03, 0.0142
    c = zeta * critical_joint_damping(rate / (2.0 * np.pi), inertia=inertia)
    # roots of I s^2 + c s + I w^2
    roots = np.roots([inertia, c, inertia * rate**2])
    assert -roots.real.max() / rate == pytest.approx(zeta, rel=1e-12)


@pytest.mark.parametrize('zeta', [0.01, 0.1, 0.3])
def test_exact_decrement_has_no_small_damping_error(zeta: float) -> None:
    record = synthetic_decay([Truth(2.0, zeta)], 1000.0, 6.0, Defects(snr_db=120.0)).record
    found = log_decrement(record)
    # the last extremes that count are ten times the noise: parts in a thousand of the slope
    assert found.damping_ratio == pytest.approx(zeta, rel=5e-3)
    assert found.frequency == pytest.approx(2.0, rel=5e-3)
    book = zeta / np.sqrt(1.0 - zeta**2)
    assert damping_ratio(found.decrement, 'book') == pytest.approx(book, rel=6e-3)


def test_book_reading_of_a_small_decay_agrees_with_the_exact_one() -> None:
    made = synthetic_decay([Truth(1.0, 0.0142)], 200.0, 12.0, Defects(snr_db=60.0, offset=0.3), 2)
    # the book's needs the level that the decay ends at; half the tail's swing is its error
    assert log_decrement(made.record, 'book').damping_ratio == pytest.approx(0.0142, rel=0.1)
    assert log_decrement(made.record).damping_ratio == pytest.approx(0.0142, rel=0.01)


def test_record_without_crests_is_refused() -> None:
    t = np.linspace(0.0, 1.0, 100)
    with pytest.raises(dn.IdentificationError, match='at least 2 crests above the noise, got 0'):
        log_decrement(Record(t, np.exp(-t)))


def test_crests_of_less_than_a_cycle_are_refused() -> None:
    t = np.arange(0.0, 2.0, 0.001)
    knots = [(0.0, 0.0), (0.2, 1.0), (0.25, -0.5), (0.3, 0.9), (1.2, -0.8), (2.0, -0.75)]
    record = Record(t, PchipInterpolator(*np.transpose(knots))(t))
    # crests 0.1 s apart, of extremes that are a third of a second apart
    with pytest.raises(dn.IdentificationError, match='a cycle apart, got'):
        log_decrement(record, 'book')


def test_missing_inertia_and_link_are_refused() -> None:
    with pytest.raises(dn.IdentificationError, match='inertia about the joint must be given'):
        critical_joint_damping(1.0)
    with pytest.raises(dn.IdentificationError, match='mass_per_length and length must be given'):
        critical_joint_damping(1.0, convention='book')


def test_crests_are_those_of_the_mode_that_is_known() -> None:
    t = np.arange(0.0, 6.0, 0.005)
    slow = np.exp(-0.1 * t) * np.cos(2.0 * np.pi * 1.8 * t)
    record = Record(t, slow + 0.15 * np.cos(2.0 * np.pi * 21.9 * t))
    # without the frequency every wave of the faster motion counts
    assert log_decrement(record).frequency > 10.0
    found = log_decrement(record, 'exact', 1.8)
    # the other motion moves each crest by up to half of its own cycle
    assert found.frequency == pytest.approx(1.8, rel=0.05)
    assert found.damping_ratio == pytest.approx(0.1 / (2.0 * np.pi * 1.8), rel=0.3)
    with pytest.raises(dn.IdentificationError, match=r'crests must be those of 7 Hz, got some of'):
        log_decrement(record, 'exact', 7.0)
