"""Bounds of elastic states: what a model of small deflections describes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from gauge_runs import load
from segmented_robots import strip, strip_text
from small_robots import ARM

from denoc_ros.dynamics.elastic.deflection import TipDeflections
from denoc_ros.dynamics.elastic.state_bounds import (
    DEFLECTION_SHARE,
    LARGEST_ANGLE_RAD,
    StateBounds,
)
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import StateError

STATES = 200


def bounds_of(robot: Robot) -> StateBounds:
    return StateBounds(robot, np.zeros(robot.n))


def test_an_admitted_state_bends_no_beam_beyond_its_share() -> None:
    robot = load('canadarm')
    bounds, tips, lengths = bounds_of(robot), TipDeflections(robot), (6.0, 7.0)
    rng = np.random.default_rng(0)
    admitted = 0
    for scale in 10.0 ** rng.uniform(-2.0, 1.0, STATES):
        q = np.zeros(robot.n)
        q[robot.flexible_indices] = scale * rng.standard_normal(len(robot.flexible_indices))
        bent = tips.evaluate(q, 0.0 * q)[0].reshape(-1, 6)
        within = all(
            abs(row[1]) <= DEFLECTION_SHARE * length and abs(row[5]) <= LARGEST_ANGLE_RAD
            for row, length in zip(bent, lengths, strict=True)
        )
        try:
            bounds.require(q, 0.0 * q)
        except StateError:
            continue
        admitted += 1
        assert within
    assert 0.2 * STATES < admitted < 0.9 * STATES


@pytest.mark.parametrize('rate', [False, True])
@pytest.mark.parametrize('value', [math.nan, math.inf, -math.inf, 1e300])
def test_every_coordinate_must_be_finite(value: float, rate: bool) -> None:
    robot = load('canadarm')
    bounds = bounds_of(robot)
    bounds.require(np.zeros(robot.n), np.zeros(robot.n))
    for index in range(robot.n):
        state = np.zeros((2, robot.n))
        state[int(rate), index] = value
        with pytest.raises(StateError, match=r'canadarm: .* must be from .* to .*, got '):
            bounds.require(*state)


def test_a_bound_lies_where_the_refusal_says() -> None:
    robot = load('canadarm')
    bounds, zero = bounds_of(robot), np.zeros(robot.n)
    first = robot.flexible_indices[0]
    q = zero.copy()
    q[first] = 0.99 * DEFLECTION_SHARE * 6.0  # The shape is 1 at the tip.
    bounds.require(q, zero)
    q[first] = 1.01 * DEFLECTION_SHARE * 6.0
    text = r'link_1: deflection along y at 6 m must be from -3 to 3 m, got 3\.03'
    with pytest.raises(StateError, match=text):
        bounds.require(q, zero)
    with pytest.raises(StateError, match=r'rate of link_1: .* m/s, got '):
        bounds.require(zero, 1e4 * q)


def test_segments_bend_each_by_their_own_length() -> None:
    whole, divided = strip(1), strip(8)
    coiled = np.zeros(divided.n)
    sections = range(8)
    for segment in sections:  # Each turns by 0.6 rad: together they make most of a circle.
        coiled[divided.flexible_indices[2 * segment]] = 0.3 / 8.0
    bounds_of(divided).require(coiled, 0.0 * coiled)
    tip = divided.tip_deflection('strip', coiled)
    assert np.linalg.norm(tip[:2]) > DEFLECTION_SHARE
    bent = np.zeros(whole.n)
    bent[whole.flexible_indices[0]] = 0.6
    with pytest.raises(StateError, match='strip: '):
        bounds_of(whole).require(bent, 0.0 * bent)


def test_strain_is_bounded_where_the_file_has_its_limit() -> None:
    text = strip_text(1).replace('length="1"', 'length="1" surface="0.002" strain_limit="1e-3"')
    limited, free = load_robot(text, gravity=(0, 0, 0)), strip(1)
    q = np.zeros(limited.n)
    q[limited.flexible_indices[1]] = 0.05
    bounds_of(free).require(q, 0.0 * q)
    with pytest.raises(StateError, match=r'strip: strain at .* must be from -0\.002 to 0\.002'):
        bounds_of(limited).require(q, 0.0 * q)


def test_period_and_decay_are_those_of_the_natural_modes() -> None:
    robot = load('canadarm')
    modes = robot.natural_modes(np.zeros(robot.n))
    bounds = bounds_of(robot)
    omega = 2.0 * np.pi * modes.frequencies
    assert bounds.longest_period == pytest.approx(1.0 / modes.frequencies[0], rel=1e-9)
    slowest = (modes.damping_ratios * omega).min()
    assert bounds.decay_time == pytest.approx(1.0 / slowest, rel=1e-6)
    assert bounds_of(strip(1)).decay_time == math.inf


def test_a_rigid_robot_has_only_finite_states_to_keep() -> None:
    rigid = load_robot(ARM[: ARM.index('<flexibility>')] + '</robot>')
    bounds = bounds_of(rigid)
    bounds.require(np.full(rigid.n, 1e3), np.full(rigid.n, 1e3))
    assert bounds.longest_period == bounds.decay_time == 0.0
