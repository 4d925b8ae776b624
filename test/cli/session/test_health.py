"""Health of a session's nodes: silence is judged by what the process does."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import pytest

from denoc_ros.cli.session import processes as module
from denoc_ros.cli.session.processes import (
    BEHIND,
    HUNG,
    LONGEST_SILENCE,
    STARVED,
    STOPPED,
    Activity,
    Health,
    ProcessError,
)

RATE = 500  # Hz


class World:
    """Time, a process and its words, as functions of time [s]."""

    def __init__(self) -> None:
        self.now = 0.0
        self.does: Callable[[float], Activity] = lambda now: Activity(False, False, 0.2 * now)
        self.said: Callable[[float], int] = lambda now: 1 + int(now)
        self.loop: Callable[[float], tuple[int, int]] = lambda now: (RATE * int(now), 0)
        self.error = self.divergence = ''
        self.given_up: list[str] = []

    def perf_counter(self) -> float:
        return self.now

    def activity(self, _: str) -> Activity:
        return self.does(self.now)

    def give_up(self, name: str) -> None:
        self.given_up.append(name)

    def reports(self, _: str) -> int:
        return self.said(self.now)

    def diagnostics(self, status: str) -> Mapping[str, str]:
        if status == 'plant: plant':
            return {'divergence': self.divergence}
        assert status == 'plant: loop'
        ticks, skipped = self.loop(self.now)
        return {'ticks': str(ticks), 'skipped_total': str(skipped), 'nominal_rate_hz': '500'}

    def failure(self, status: str) -> str:
        assert status == 'recorder: recording'
        return self.error


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> World:
    world = World()
    monkeypatch.setattr(module, 'time', world)
    return world


def failing(world: World, until: float = 200.0, name: str = 'plant') -> tuple[float, str]:
    """Look every 0.1 s in a phase; return when a node was given up [s], and why."""
    health = Health(world, world, moves=True)
    health.watch(name)
    while world.now < until:
        world.now += 0.1
        try:
            health.check()
        except ProcessError as error:
            return world.now, str(error)
    return until, ''


def test_a_node_that_reports_is_well(world: World) -> None:
    assert failing(world) == (200.0, '')


def test_a_stopped_process_is_named_within_seconds(world: World) -> None:
    world.does = lambda now: Activity(now > 10.0, False, 0.2 * min(now, 10.0))
    world.said = lambda now: 1 + int(min(now, 10.0))
    when, why = failing(world)
    assert STOPPED < when - 10.0 < STOPPED + 2.5
    assert 'plant: process must keep running, got one that has been stopped for' in why


def test_a_pause_by_a_debugger_is_passed_over(world: World) -> None:
    world.does = lambda now: Activity(10.0 < now < 10.0 + 0.5 * STOPPED, False, 0.2 * now)
    assert failing(world) == (200.0, '')


def test_a_silent_process_that_waits_hangs(world: World) -> None:
    world.does = lambda now: Activity(False, False, 0.2 * min(now, 10.0))
    world.said = lambda now: 1 + int(min(now, 10.0))
    when, why = failing(world)
    assert HUNG < when - 10.0 < HUNG + 2.5
    assert 'must report on /diagnostics once a second' in why
    assert 'a process that waits' in why


def test_a_silent_process_that_works_has_the_time_of_a_loaded_machine(world: World) -> None:
    world.said = lambda now: 1 + int(min(now, 10.0))
    when, why = failing(world)
    assert LONGEST_SILENCE < when - 10.0 < LONGEST_SILENCE + 2.5
    assert 'a process that works: it has used' in why


def test_a_process_that_gets_no_processor_starves(world: World) -> None:
    world.does = lambda now: Activity(False, True, 0.2 * min(now, 10.0), max(0.0, now - 10.0))
    when, why = failing(world)
    assert STARVED < when - 10.0 < STARVED + 2.5
    assert 'it starves beside others' in why
    assert world.given_up == ['plant']


def test_a_process_that_waits_for_its_share_of_a_busy_machine_is_well(world: World) -> None:
    world.does = lambda now: Activity(False, True, 0.1 * now, 2.0 * now)
    assert failing(world) == (200.0, '')


def test_a_loop_that_misses_most_of_its_deadlines_ends_a_phase(world: World) -> None:
    late = 10.0

    def ticks(now: float) -> tuple[int, int]:
        missed = round(0.7 * RATE * max(0, int(now) - late))
        return RATE * int(now) - missed, missed

    world.loop = ticks
    when, why = failing(world)
    assert BEHIND <= when - late < BEHIND + 2.5
    assert 'plant: loop must tick at 500 Hz, got 150 Hz for 5 s' in why
    assert '--time simulated' in why


def test_a_loop_that_is_late_for_a_moment_goes_on(world: World) -> None:
    world.loop = lambda now: (RATE * int(now) - 2 * RATE * (now > 10.0), 2 * RATE * (now > 10.0))
    assert failing(world) == (200.0, '')


def test_silence_counts_only_while_the_session_has_its_own_turns(world: World) -> None:
    """It was stopped itself, with all of its nodes: afterwards nobody had spoken for a minute."""
    health = Health(world, world)
    health.watch('plant')
    world.does = lambda now: Activity(False, False, 0.0)
    world.said = lambda now: 1 + int(now > 100.0)
    for now in (1.0, 2.0, 90.0, 91.0, 101.0):
        world.now = now
        health.check()


def test_a_recording_that_ended_ends_the_session(world: World) -> None:
    world.error = 'disk must keep 64 MiB free, got 3 MiB; recording ended, the bag is whole'
    assert 'recorder: recording must go on, got: disk must keep 64 MiB' in failing(world)[1]


def test_nobody_waits_for_the_viewer(world: World) -> None:
    world.does = lambda now: Activity(True, False, 0.0)
    assert failing(world, name='viewer') == (200.0, '')


def test_a_plant_that_has_diverged_ends_the_session(world: World) -> None:
    assert failing(world, 10.0) == (10.0, '')
    world.divergence = 'the simulated state diverged 0.40 s after its start: ...'
    when, why = failing(world)
    assert when < 12.5
    assert 'plant: state must be one that the robot can have, got: the simulated state' in why
