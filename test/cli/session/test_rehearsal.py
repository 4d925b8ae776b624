"""Real or simulated time: what a machine holds with a factor of two to spare."""

from __future__ import annotations

import dataclasses

import pytest

from denoc_ros.cli.session.session_time import Rehearsal, choose

QUIET = Rehearsal(
    rates={'plant': 1000.0, 'feedforward': 1000.0, 'predictor': 1000.0},
    used=0.9,
    idle=1.1,
    cores=2,
    late=0.001,
    lost=0,
)


def test_a_fast_machine_runs_at_the_rates_of_the_configuration() -> None:
    choice = choose(QUIET)
    assert (choice.mode, choice.rates) == ('real', QUIET.rates)
    assert choice.why.startswith('real time at 1000 Hz: 1.10 of 2 cores idle')


@pytest.mark.parametrize(('idle', 'rate'), [(0.8, 500.0), (0.3, 250.0)])
def test_a_slower_machine_runs_at_lower_rates(idle: float, rate: float) -> None:
    choice = choose(dataclasses.replace(QUIET, idle=idle))
    assert choice.mode == 'real'
    assert set(choice.rates.values()) == {rate}


def test_a_rate_at_which_feedback_is_not_stable_is_not_chosen() -> None:
    slow, asked = dataclasses.replace(QUIET, idle=0.3), []

    def refusal(rate: float) -> str:
        asked.append(rate)
        return f'unstable at {rate:g} Hz'

    choice = choose(slow, refusal)
    assert (choice.mode, choice.rates, asked) == ('simulated', QUIET.rates, [250.0])
    assert choice.why.startswith('simulated time: unstable at 250 Hz; 1000 Hz in real time are')
    assert choose(QUIET, refusal).mode == 'real'  # nobody lowers a rate
    assert asked == [250.0]


def test_no_loop_is_faster_than_its_configuration_says() -> None:
    given = {'plant': 500.0, 'feedforward': 500.0, 'predictor': 100.0}
    assert choose(dataclasses.replace(QUIET, rates=given)).rates == given
    slow = choose(dataclasses.replace(QUIET, rates=given, idle=0.6))
    assert slow.rates == {'plant': 250.0, 'feedforward': 250.0, 'predictor': 100.0}


def test_rates_that_the_configuration_says_stay() -> None:
    fixed = dataclasses.replace(QUIET, idle=0.6, fixed=frozenset(QUIET.rates))
    assert (choose(fixed).mode, choose(fixed).rates) == ('simulated', QUIET.rates)


def test_a_machine_without_idle_cores_simulates_and_says_what_it_needs() -> None:
    choice = choose(dataclasses.replace(QUIET, idle=0.0))
    assert (choice.mode, choice.rates) == ('simulated', QUIET.rates)
    assert 'this machine needs 2.0 s for each second' in choice.why


def test_late_loops_and_lost_messages_count_beside_processors() -> None:
    lossy = dataclasses.replace(QUIET, lost=12)
    assert set(choose(lossy).rates.values()) == {500.0}
    late = choose(dataclasses.replace(QUIET, late=0.5))
    assert late.mode == 'simulated'
    assert 'miss 50 % of their deadlines' in late.why


def test_one_core_must_hold_the_loops_thrice() -> None:
    alone = dataclasses.replace(QUIET, cores=1, used=0.46, idle=0.51)
    assert choose(dataclasses.replace(alone, cores=2)).rates == QUIET.rates
    assert max(choose(alone).rates.values()) < 1000.0
    fixed = choose(dataclasses.replace(alone, fixed=frozenset(QUIET.rates)))
    assert fixed.mode == 'simulated'
    assert 'with a factor of 3 to spare this machine needs 1.4 s' in fixed.why
