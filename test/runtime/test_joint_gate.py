"""Which joint samples pass, and which velocities are used. No graph."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import pytest

from denoc_ros.estimation.turns import nearest_turns, unwrap_path
from denoc_ros.runtime.inputs.input_monitor import InputError, InputMonitor
from denoc_ros.runtime.inputs.joint_gate import CONFIRMATION_S, JointGate, JointSample
from denoc_ros.runtime.inputs.velocity_check import VelocityCheck
from denoc_ros.types import Array

STEP = 0.004  # s
TIMES = np.arange(0.0, 3.0, STEP)
WRONG = 250  # place of a wrong sample, in the middle of the motion


def motion(times: Array = TIMES) -> tuple[Array, Array]:
    """Return positions and velocities of a swing from rest to rest across half a turn."""
    s = np.clip((times - 0.4) / 1.6, 0.0, 1.0)
    position = 2.4 + 1.8 * s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
    return position, 1.8 * 30.0 * (s * (1.0 - s)) ** 2 / 1.6


def samples(position: Array, velocity: Array | None = None) -> list[JointSample]:
    rates = [None] * len(position) if velocity is None else velocity[:, None]
    return [
        JointSample(float(t), np.array([q]), qd)
        for t, q, qd in zip(TIMES, position, rates, strict=False)
    ]


class Gate:
    """A gate of one continuous joint, what passes, and what is refused."""

    def __init__(self, limit: float = 10.0) -> None:
        self.gate = JointGate(['swing'], [True], np.array([limit]))
        self.refused: list[InputError] = []
        self.waits = 0

    def pass_all(self, given: Iterable[JointSample]) -> list[JointSample]:
        passed: list[JointSample] = []
        for each in given:
            some = self.gate.offer(each, self.refused.append)
            self.waits += not some
            passed += some
        return passed


@pytest.mark.parametrize('with_velocity', [False, True])
def test_a_turn_more_or_less_changes_nothing(with_velocity: bool) -> None:
    position, velocity = motion()
    given = velocity if with_velocity else None
    wrapped = (position + math.pi) % (2.0 * math.pi) - math.pi
    assert np.abs(np.diff(wrapped)).max() > 6.0
    gate = Gate()
    passed = gate.pass_all(samples(wrapped, given))
    assert not gate.refused
    np.testing.assert_allclose([each.position[0] for each in passed], position, atol=1e-12)


def test_joints_that_are_not_continuous_keep_their_turn() -> None:
    position = 2.0 * np.pi * np.arange(3.0)[:, None]
    fixed, there = np.array([False]), np.zeros(1)
    np.testing.assert_array_equal(nearest_turns(position, there, fixed), position)
    times = np.array([0.0, 1.0, 1.1])
    np.testing.assert_array_equal(unwrap_path(times, position, fixed), position)


def test_paths_of_continuous_joints_have_no_jump_by_a_turn_and_may_turn_more() -> None:
    times = np.arange(0.0, 1.0, 0.05)
    path = 2.4 + 3.0 * times[:, None] ** 2
    wrapped = (path + math.pi) % (2.0 * math.pi) - math.pi
    assert np.abs(np.diff(wrapped, axis=0)).max() > 6.0
    turns = np.array([True])
    np.testing.assert_allclose(unwrap_path(times, wrapped, turns), path, atol=1e-12)
    for k in (2, 3):  # a turn and a half, point by point
        wide = np.linspace(0.0, 3.0 * math.pi, k)[:, None]
        even = np.linspace(0.0, 5.0, k)
        np.testing.assert_array_equal(unwrap_path(even, wide, turns), wide)


@pytest.mark.parametrize('limit', [10.0, math.inf])
@pytest.mark.parametrize(
    ('what', 'error'), [('q', 2.0), ('q', -0.03), ('qd', 50.0), ('qd', -0.5), ('q alone', 0.3)]
)
def test_one_wrong_sample_is_refused_and_leaves_no_trace(
    limit: float, what: str, error: float
) -> None:
    position, velocity = motion()
    (velocity if what == 'qd' else position)[WRONG] += error
    given = samples(position, None if what == 'q alone' else velocity)
    gate, without = Gate(limit), Gate(limit)
    passed = gate.pass_all(given)
    assert [each.cause for each in gate.refused] == ['implausible']
    assert 'swing' in str(gate.refused[0])
    assert passed == without.pass_all(given[:WRONG] + given[WRONG + 1 :])


def test_motions_as_sensors_measure_them_pass() -> None:
    position, velocity = motion()
    rng = np.random.default_rng(1)
    noise = rng.standard_normal((2, len(position)))
    every_third = 3 * (np.arange(len(position)) // 3)
    for q, qd in (
        (position + 1e-4 * noise[0], velocity + 0.02 * noise[1]),
        (position + 1e-2 * noise[0], None),
        (np.round(position / 5e-3) * 5e-3, None),
        (position[every_third], velocity[every_third]),  # read faster than it is measured
    ):
        gate = Gate()
        assert len(gate.pass_all(samples(q, qd))) == len(position)
        assert not gate.refused
        assert gate.waits <= 3


def test_messages_that_come_late_and_at_once_pass() -> None:
    position, _ = motion()
    place = np.arange(len(position))
    late = place % 60 < 12  # They come when the last of them is there.
    times = np.where(late, (place // 60 * 60 + 12) * STEP + 2e-5 * (place % 60), TIMES)
    given = [
        JointSample(float(t), np.array([q])) for t, q in zip(times, position, strict=True) if t
    ]
    gate = Gate()
    passed = gate.pass_all(given)
    assert not any(each.restarts for each in passed)
    assert len(gate.refused) <= 2
    assert len(passed) >= len(given) - 2


def test_a_start_at_once_passes_whole_one_sample_late() -> None:
    position = 3.0 * np.maximum(TIMES - 1.0, 0.0)
    gate = Gate()
    passed = gate.pass_all(samples(position))
    np.testing.assert_array_equal([each.position[0] for each in passed], position)
    assert gate.waits == 1


def test_a_jump_that_stays_starts_the_motion_again_after_a_while() -> None:
    position, _ = motion()
    position[WRONG:] += 0.5
    gate = Gate()
    passed = gate.pass_all(samples(position))
    restarts = [each.time for each in passed if each.restarts]
    assert len(restarts) == 1
    assert gate.gate.restarts == 1
    begin = TIMES[WRONG]
    assert not [each for each in passed if begin <= each.time < begin + CONFIRMATION_S]
    assert restarts[0] == pytest.approx(begin + CONFIRMATION_S, abs=2 * STEP)
    assert passed[-1].position[0] == position[-1]


def test_many_wrong_samples_in_a_row_never_pass() -> None:
    position, _ = motion()
    wild = np.random.default_rng(2).uniform(-1e3, 1e3, 60)
    position[WRONG : WRONG + 60] += wild
    gate = JointGate(['lift'], [False], np.array([10.0]))
    refused: list[InputError] = []
    passed = [one for each in samples(position) for one in gate.offer(each, refused.append)]
    assert len(refused) >= 60
    good = motion()[0]
    np.testing.assert_allclose(
        [each.position[0] for each in passed], np.interp([e.time for e in passed], TIMES, good)
    )


def test_messages_count_when_they_pass() -> None:
    monitor = InputMonitor('joint_states')
    monitor.accept(1, 1.0)
    monitor.revise(1)
    monitor.accept(2, 2.0)
    monitor.revise(0)  # it waits
    assert (monitor.accepted, monitor.age(3.0)) == (1, 2.0)
    monitor.accept(3, 3.0)
    monitor.revise(2)
    assert (monitor.accepted, monitor.age(3.0)) == (3, 0.0)


class Check:
    """A check of one joint's velocities behind a gate, and when it doubts them."""

    def __init__(self, rewinds: bool = False) -> None:
        self.gate = Gate()
        self.check = VelocityCheck(['swing'], np.array([10.0]), rewinds)
        self.reasons: dict[float, str] = {}
        self.taken: list[JointSample] = []

    def take_all(self, given: Iterable[JointSample]) -> None:
        for each in given:
            for passed in self.gate.pass_all([each]):
                self.taken += self.check.take(passed, self.gate.gate.deviation)
            self.gate.gate.ignores_velocity = bool(self.check.reason)
            self.reasons[each.time] = self.check.reason


@pytest.mark.parametrize(
    ('fault', 'says'),
    [
        ('degrees', '57.3 times the change of position: degrees instead of radians'),
        ('sign', '-1 times the change of position: the sign is wrong'),
        ('zero', 'frozen at 0'),
        ('half', '0.5 times the change of position'),
    ],
)
def test_velocities_that_contradict_positions_are_not_used(fault: str, says: str) -> None:
    position, velocity = motion()
    factor = {'degrees': math.degrees(1.0), 'sign': -1.0, 'zero': 0.0, 'half': 0.5}[fault]
    check = Check(rewinds=True)
    check.take_all(samples(position, factor * velocity))
    found = {time: reason for time, reason in check.reasons.items() if reason}
    begin = min(found)
    assert begin < 0.4 + 0.4  # the motion begins at 0.4 s
    assert found[begin].startswith('swing: velocity ')
    assert says in found[begin]
    assert set(found) == {time for time in check.reasons if time >= begin}
    # The motion is described again without velocities, from a time at which nothing moved.
    place = next(k for k, each in enumerate(check.taken) if each.restarts)
    assert check.taken[place].time <= 0.4
    assert all(each.velocity is None for each in check.taken[place:])
    again = [each.time for each in check.taken[place:]]
    assert again == sorted(again)


def test_velocities_as_drives_measure_them_are_used() -> None:
    position, velocity = motion()
    noise = np.random.default_rng(3).standard_normal((2, len(position)))
    late = np.interp(TIMES - 0.015, TIMES, velocity)
    for q, qd in (
        (position, velocity),
        (position + 1e-3 * noise[0], velocity + 0.05 * noise[1]),
        (np.round(position / 1e-3) * 1e-3, np.round(velocity / 0.02) * 0.02),
        (position, late),
        (position, 0.9 * velocity + 0.03),
    ):
        check = Check()
        check.take_all(samples(q, qd))
        assert not any(check.reasons.values())


def test_velocities_are_used_again_after_they_agreed_for_a_while() -> None:
    times = np.arange(0.0, 8.0, STEP)
    position, velocity = np.sin(2.0 * times), 2.0 * np.cos(2.0 * times)
    wrong = times < 2.0
    given = [
        JointSample(float(t), np.array([q]), np.array([qd * (-1.0 if bad else 1.0)]))
        for t, q, qd, bad in zip(times, position, velocity, wrong, strict=True)
    ]
    check = Check()
    check.take_all(given)
    doubted = [time for time, reason in check.reasons.items() if reason]
    assert doubted[0] < 0.5
    assert 2.5 < doubted[-1] < 5.0
    assert check.taken[-1].velocity is not None
