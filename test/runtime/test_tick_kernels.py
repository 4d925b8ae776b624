"""What a tick calls as compiled code does what it did as arrays and lists of Python."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from denoc_ros.bags.joint_state import FIELDS, JointStateMessage
from denoc_ros.dynamics.elastic.deflection import TipDeflections
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.errors import StateError
from denoc_ros.estimation.joint_tracker import TrackingFilter
from denoc_ros.kernels.runtime.joint_tracking import MEMORY
from denoc_ros.kernels.runtime.torque_limits import saturate
from denoc_ros.model.tree import Limits
from denoc_ros.runtime.inputs.input_monitor import InputError
from denoc_ros.runtime.inputs.message_numbers import MessageFiller
from denoc_ros.runtime.inputs.message_readers import LARGEST_EFFORT, JointStateReader
from denoc_ros.runtime.safety.motion_bounds import MotionBounds
from denoc_ros.runtime.safety.torque import TorqueLimiter
from denoc_ros.trajectories import SplineTrajectory
from denoc_ros.types import Array

SSRMS = Path(__file__).parents[2] / 'config' / 'robots' / 'ssrms.urdf'
JOINTS = ('a', 'b', 'c')
ANY = st.one_of(
    st.floats(-4.0, 4.0), st.floats(), st.sampled_from([np.nan, np.inf, -np.inf, 1e300, 3.0])
)
ROW = st.lists(ANY, min_size=3, max_size=3)


def reading(
    reader: JointStateReader, raw: bytes, stepwise: bool, with_effort: bool
) -> list[object]:
    """Return what a message gives, or the cause and the words of its refusal."""
    admitted: list[int] = []
    try:
        if stepwise:
            reader._read_stepwise(raw, admitted.append, with_effort)
        else:
            reader.read(raw, admitted.append, with_effort)
    except InputError as error:
        return [error.cause, str(error)]
    values = [reader.position, reader.velocity, reader.effort]
    flags = [reader.stamp_ns, reader.has_velocity, reader.has_effort]
    return [*admitted, *flags, *(row.tolist() for row in values)]


@settings(max_examples=300, deadline=None)
@given(
    rows=st.tuples(ROW, ROW, ROW),
    fields=st.sampled_from([FIELDS, FIELDS[:2], FIELDS[:1], (FIELDS[0], FIELDS[2])]),
    order=st.permutations(JOINTS),
    bounded=st.booleans(),
    with_effort=st.booleans(),
    stamp_ns=st.integers(-(1 << 60), 1 << 60),
    broken=st.one_of(st.none(), st.tuples(st.integers(0, 200), st.integers(0, 255))),
    length=st.integers(-9, 5),
)
def test_a_message_of_known_layout_is_taken_or_refused_as_step_by_step(
    rows: tuple[list[float], ...],
    fields: tuple[str, ...],
    order: list[str],
    bounded: bool,
    with_effort: bool,
    stamp_ns: int,
    broken: tuple[int, int] | None,
    length: int,
) -> None:
    limits = [Limits(lower=-1.0, upper=2.0, velocity=1.5, effort=1.0) for _ in JOINTS]
    bounds = MotionBounds(order, limits, 0.5, 100.0, 2.0) if bounded else None
    message = JointStateMessage(JOINTS, fields, 'frame')
    at_rest = message.bytes()
    for field, row in zip(FIELDS, rows, strict=True):
        if field in fields:
            getattr(message, field)[:] = row
    raw = bytearray(message.bytes(stamp_ns))
    if broken is not None:
        raw[broken[0] % len(raw)] = broken[1]
    if length:
        raw = raw[:length] if length < 0 else raw + bytes(length)
    found = []
    for stepwise in (False, True):
        reader = JointStateReader(order, bounds=bounds)
        reader.read(at_rest)
        found.append(reading(reader, bytes(raw), stepwise, with_effort))
    assert found[0] == found[1]


@pytest.mark.parametrize(
    ('module', 'kernel', 'taker'),
    [
        ('runtime.message_values', 'take_numbers', "message_readers.JointStateReader(['a'])"),
        ('runtime.message_values', 'take_numbers', "message_readers.CommandReader(['a'])"),
        ('algebra.spline', 'sample_quintics', 'reference.ReferenceFollower(1, 0.1)'),
    ],
)
def test_what_a_first_message_needs_is_loaded_before_it(
    module: str, kernel: str, taker: str
) -> None:
    source = f"""
from denoc_ros.kernels.{module} import {kernel}
from denoc_ros.runtime.inputs import message_readers
from denoc_ros.runtime.reference import reference
assert not {kernel}.overloads
{taker}
assert {kernel}.overloads
"""
    subprocess.run([sys.executable, '-c', source], check=True, timeout=300)


@settings(max_examples=50, deadline=None)
@given(
    stamp_ns=st.one_of(
        st.integers(-(1 << 62), 1 << 62),
        st.sampled_from([-1, 0, 999_999_999, 1 << 31, (1 << 31) * 1_000_000_000]),
    ),
    order=st.permutations(range(3)),
)
def test_filled_messages_are_those_that_are_written_field_by_field(
    stamp_ns: int, order: list[int]
) -> None:
    random, places = np.random.default_rng(1), np.array(order)
    names, filled = list(JOINTS), [JointStateMessage(JOINTS, FIELDS, 'frame') for _ in range(2)]
    q, unstamped = random.standard_normal(3), filled[1].bytes()
    matrix = random.standard_normal((4, 4))
    column = matrix.ravel(), np.array([3, 7, 11])
    first, second = filled
    filler = MessageFiller(
        [first],
        [
            (first.position, (q, places)),
            ((first.velocity, places), q),
            (first.effort, column),
            (second.effort, matrix[:3, 1]),
        ],
    )
    for _ in range(2):  # what is in the arrays by then
        q[:] = random.standard_normal(3)
        matrix[:] = random.standard_normal((4, 4))
        filler.fill(stamp_ns)
        velocity = np.zeros(3)
        velocity[places] = q
        expected = JointStateMessage(names, FIELDS, 'frame')
        raw = expected.encode(stamp_ns, q[places], velocity, matrix[:3, 3])
        assert first.bytes() == raw
        second.effort[:] -= matrix[:3, 1]
        assert second.bytes() == unstamped


def test_only_vectors_of_doubles_are_copied_into_messages() -> None:
    message = JointStateMessage(JOINTS, FIELDS)
    others: list[Any] = [np.zeros(3, dtype=np.int64), np.zeros((3, 1))]
    for wrong in others:
        with pytest.raises(ValueError, match='numbers must be a vector of doubles'):
            MessageFiller([message], [(message.position, wrong)])
    with pytest.raises(ValueError, match='as many numbers'):
        MessageFiller([message], [(message.position, np.zeros(2))])


@given(
    wanted=st.lists(st.floats(-3.0, 3.0) | st.just(np.nan), min_size=3, max_size=3),
    order=st.permutations(range(4)),
)
def test_efforts_are_saturated_and_put_where_their_drives_are(
    wanted: list[float], order: list[int]
) -> None:
    limits, tau, effort = np.array([1.0, 2.0, np.inf]), np.full(4, 7.0), np.zeros(3)
    places = np.array(order[:3])
    saturate(np.array(wanted), limits, effort, places, tau)
    np.testing.assert_array_equal(effort, np.clip(wanted, -limits, limits))
    expected = np.full(4, 7.0)
    expected[places] = effort
    np.testing.assert_array_equal(tau, expected)


@pytest.mark.parametrize('has_rates', [True, False])
def test_tracking_equals_its_equations_in_arrays(has_rates: bool) -> None:
    random = np.random.default_rng(5)
    tracker, cutoff = TrackingFilter(4, 30.0), 30.0
    q, qd, qdd, unsteady = np.zeros((4, 4))
    for _ in range(50):
        interval = random.uniform(5e-4, 5e-3)
        measured, rates = random.standard_normal((2, 4))
        tracker.update(measured, rates if has_rates else None, interval)
        before, pole = qd.copy(), math.exp(-2.0 * math.pi * cutoff * interval)
        q = q + interval * qd + 0.5 * interval**2 * qdd
        qd = qd + interval * qdd
        error, slip = measured - q, rates - qd
        if has_rates:
            q, qd = q + (1.0 - pole) * error, qd + (1.0 - pole**2) * slip
            qdd = qdd + (1.0 - pole) ** 2 / interval * slip
        else:
            q = q + (1.0 - pole**3) * error
            qd = qd + 1.5 * (1.0 - pole) ** 2 * (1.0 + pole) / interval * error
            qdd = qdd + (1.0 - pole) ** 3 / interval**2 * error
        mean = (qd - before) / interval
        unsteady = unsteady - math.expm1(-interval / MEMORY) * ((mean - qdd) ** 2 - unsteady)
        expected = (q, qd, qdd, mean, unsteady)
        found = (tracker.q, tracker.qd, tracker.qdd, tracker.mean, tracker.unsteady)
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-9)


def test_tracking_takes_any_arrays_of_its_joints_and_no_others() -> None:
    tracker, same = TrackingFilter(2, 30.0), TrackingFilter(2, 30.0)
    table = np.arange(12.0).reshape(3, 4)
    tracker.update(table[:2, 1], table[:2, 2], 1e-3)
    same.update(table[:2, 1].copy(), table[:2, 2].copy(), 1e-3)
    np.testing.assert_array_equal(tracker.q, same.q)
    with pytest.raises(StateError, match='measured joints must be 2'):
        tracker.update(np.zeros(3), None, 1e-3)


def test_deflections_equal_the_products_of_their_rows() -> None:
    deflections = TipDeflections(load_robot(SSRMS))
    random = np.random.default_rng(3)
    size, n = len(deflections.names), deflections._rows.shape[1]
    for _ in range(20):
        q, qd = random.standard_normal((2, n))
        both, moving = deflections._rows @ q, deflections._rows @ qd
        position, rate = both[:size], moving[:size]
        position[::6] = deflections._owner @ (both[size:] * q)
        rate[::6] = deflections._owner @ (2.0 * both[size:] * qd)
        found = deflections.evaluate(q, qd)
        np.testing.assert_allclose(found[0], position, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(found[1], rate, rtol=1e-12, atol=1e-14)


@settings(max_examples=200, deadline=None)
@given(
    torques=st.lists(ROW, min_size=1, max_size=6),
    limits=st.lists(st.floats(0.0, 10.0), min_size=3, max_size=3),
    most=st.one_of(st.just(math.inf), st.floats(1e-3, 10.0)),
)
def test_torque_leaves_as_limited_element_by_element(
    torques: list[list[float]], limits: list[float], most: float
) -> None:
    limiter = TorqueLimiter(np.array(limits), most)
    last: Array = np.zeros(3)
    clamped, non_finite = np.zeros(3, dtype=np.int64), 0
    for row in torques:
        wanted = np.array(row)
        if not (np.abs(wanted) <= LARGEST_EFFORT).all():
            non_finite, wanted = non_finite + 1, last
        new = np.clip(wanted, -np.array(limits), limits)
        new = np.clip(new, last - most, last + most)
        clamped += new != wanted
        last = new
        np.testing.assert_array_equal(limiter.apply(np.array(row)), last)
    np.testing.assert_array_equal(limiter.clamped, clamped)
    assert limiter.non_finite == non_finite


def test_a_spline_is_the_polynomial_of_its_piece_and_its_derivatives() -> None:
    random = np.random.default_rng(7)
    times = np.cumsum(random.uniform(0.1, 1.0, 6)) - 0.05
    spline = SplineTrajectory(times, *random.standard_normal((3, 6, 2)))
    q, qd, qdd = np.zeros((3, 2))
    for t in random.uniform(0.0, spline.duration, 200):
        spline.sample(t, q, qd, qdd)
        piece = max(k for k, begin in enumerate(spline._times[:-1]) if begin <= t)
        for joint in range(2):
            law = np.polynomial.Polynomial(spline._pieces[piece, :, joint])
            s = t - spline._times[piece]
            found = q[joint], qd[joint], qdd[joint]
            expected = law(s), law.deriv()(s), law.deriv(2)(s)
            np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-9)
