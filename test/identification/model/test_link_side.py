"""Identification on the side of springs that joint states and effort mean."""

from __future__ import annotations

import numpy as np
import pytest
from geared_arm import arm_text

import denoc_ros as dn
from denoc_ros.dynamics.measured_side import MeasuredStates
from denoc_ros.errors import ConfigError
from denoc_ros.identification.apply import configuration
from denoc_ros.identification.model.fit import identify_model
from denoc_ros.identification.model.free_parameters import FreeParameters
from denoc_ros.identification.model.recording import Recording

PAYLOAD = 1.5  # kg
STEP, COUNT = 5e-3, 600


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
