"""Identification on the side of springs that joint states and effort mean."""

from __future__ import annotations

import numpy as np
import pytest
from geared_arm import arm_text

import denoc_ros as dn
from denoc_ros.dynamics.driven.measured_side import MeasuredStates, measured_robot
from denoc_ros.dynamics.driven.torque_feedforward import TorqueFeedforward
from denoc_ros.errors import ConfigError
from denoc_ros.identification.decay.damping import configuration
from denoc_ros.identification.model.free_parameters import FreeParameters
from denoc_ros.identification.model.model_fit import identify_model
from denoc_ros.identification.model.sources import Recording

PAYLOAD = 1.5  # kg
STEP, COUNT = 5e-3, 600
EFFORT_NOISE = 1.0  # N m


def recorded() -> Recording:
    """Links on a known motion, their joints measured there: the effort is what gears give out."""
    # rigid behind the gears: what link-side states describe, by another robot of the library
    text = arm_text('link')
    bare = text[: text.index('<flexibility>')] + '</robot>'
    robot = dn.load_robot(
        bare.replace('damping="1.5" friction="0.4"', '').replace(
            'damping="0.8" friction="0.2"', ''
        )
    )
    robot.set_payload('tool', PAYLOAD)
    t = np.arange(COUNT, dtype=np.float64) * STEP
    waves = np.array([2.0, 3.1]), np.array([0.5, 0.4])
    q = waves[1] * np.sin(np.outer(t, waves[0]))
    qd = waves[1] * waves[0] * np.cos(np.outer(t, waves[0]))
    qdd = -q * waves[0] ** 2
    return Recording(t, robot.joint_names, q, robot.inverse_dynamics(q, qd, qdd), qd)


def test_a_payload_is_found_from_effort_behind_the_gears() -> None:
    found = identify_model(dn.load_robot(arm_text('link')), recorded(), ['payload.tool.mass'])
    # taken for the motors', friction and armature make it 1.85 kg; a low-pass leaves 1e-4
    assert found.values['payload.tool.mass'] == pytest.approx(PAYLOAD, rel=1e-3)


def test_what_link_states_do_not_show_cannot_be_free() -> None:
    robot = dn.load_robot(arm_text('link'))
    with pytest.raises(ConfigError, match=r'joint\.elbow\.stiffness.* measured on the link side'):
        FreeParameters(robot, ['joint.elbow.stiffness'])
    assert FreeParameters(robot, ['effort.elbow.*']).size == 2
    assert FreeParameters(dn.load_robot(arm_text('motor')), ['joint.elbow.stiffness']).size == 1


def test_modes_are_those_where_the_measured_side_stands() -> None:
    robot = dn.load_robot(arm_text('link'))
    at = {'shoulder': 0.4, 'elbow': -0.7}
    q, seen = configuration(robot, at), np.zeros(2)
    MeasuredStates(robot).positions(q, seen)
    # springs give way by 3 mrad; what a round leaves is that share of it, five times
    np.testing.assert_allclose(seen, list(at.values()), atol=1e-9)


def test_a_motion_that_identifies_keeps_the_limits_of_motors_behind_their_springs() -> None:
    # so that effort is what ends the motion: the gears alone would need 97 of 137 N m
    text = arm_text('link').replace('effort="200"', 'effort="100"')
    robot = dn.load_robot(text)
    motion = dn.design_excitation(
        robot,
        ['payload.tool.mass'],
        duration=3.0,
        harmonics=3,
        noise={'effort': EFFORT_NOISE},
        time_limit=1.0,
    )
    assert motion.joints == ('shoulder', 'elbow')
    assert motion.verdict == {'payload.tool.mass': 'found'}
    largest = {each.name: each.value for each in motion.extremes if each.what == 'effort'}
    t = np.arange(0.0, 3.0, STEP / 5)
    rows = motion.rows(t)
    seen, needed = measured_robot(robot), []
    source = TorqueFeedforward(seen)
    for k in range(len(t)):
        needed.append(source.update(rows.q[k], rows.qd[k], rows.qdd[k], STEP / 5).copy())
    # the springs' own acceleration is left out of the limits: found 0.3 %
    drive = np.abs(needed).max(axis=0)
    np.testing.assert_allclose(list(largest.values()), drive, rtol=0.02)
    assert drive.max() < 102.0
    # effort of the record is the gears': it finds the payload within what was foretold
    heavy = seen.copy()
    heavy.set_payload('tool', PAYLOAD)
    at = motion.rows(np.arange(0.0, 3.0, STEP))
    effort = heavy.inverse_dynamics(at.q, at.qd, at.qdd)
    effort += EFFORT_NOISE * np.random.default_rng(2).standard_normal(effort.shape)
    recording = Recording(at.t, robot.joint_names, at.q, effort, at.qd)
    found = identify_model(robot, recording, ['payload.tool.mass'])
    low, high = found.interval['payload.tool.mass']
    assert abs(found.values['payload.tool.mass'] - PAYLOAD) < 2.0 * (high - low)
    foretold = np.ptp(motion.interval['payload.tool.mass'])
    assert high - low == pytest.approx(foretold, rel=0.5)


def test_no_motion_is_sought_for_what_link_states_do_not_show() -> None:
    robot = dn.load_robot(arm_text('link'))
    with pytest.raises(ConfigError, match='measured on the link side'):
        dn.design_excitation(robot, ['joint.elbow.stiffness'], duration=3.0)
