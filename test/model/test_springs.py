"""`<spring>`: what it may say, and every other thing refused with its reason."""

from __future__ import annotations

import pytest
from small_robots import block, joint, link, robot

from denoc_ros.errors import ConfigError, ModelError
from denoc_ros.model.numbers import values_of
from denoc_ros.model.overrides import with_overrides
from denoc_ros.model.tree import Spring

LINKS = (link('base'), link('arm'), link('slide'), link('hand'))
JOINTS = (
    joint('elbow', 'base', 'arm'),
    joint('rail', 'arm', 'slide', kind='prismatic'),
    joint('grip', 'slide', 'hand', kind='fixed'),
)
GOOD = '<spring joint="elbow" stiffness="1.2e4" damping="8" measured="link"/>'
ROTORS = '<actuator joint="elbow" armature="0.9"/><actuator joint="rail" armature="4"/>'
BAD = [
    ('<spring stiffness="1"/>', 'joint must be given, got nothing'),
    ('<spring joint="wrist" stiffness="1"/>', "joint must be a movable joint .*, got 'wrist'"),
    ('<spring joint="grip" stiffness="1"/>', "joint must be a movable joint .*, got 'grip'"),
    ('<spring joint="elbow"/>', "'elbow': stiffness must be > 0 N m/rad, got nothing"),
    ('<spring joint="elbow" stiffness="0"/>', 'stiffness must be > 0 N m/rad, got 0'),
    ('<spring joint="rail" stiffness="-2"/>', "'rail': stiffness must be > 0 N/m, got -2"),
    ('<spring joint="elbow" stiffness="nan"/>', "stiffness must be > 0 N m/rad, got 'nan'"),
    (f'{GOOD}{GOOD}', "spring of joint 'elbow': must occur once, got it twice"),
    ('<spring joint="elbow" stiffness="1" damping="-1"/>', 'damping must be >= 0 .*, got -1'),
    ('<spring joint="elbow" stiffness="1" stiffness3="-1"/>', 'stiffness3 must be >= 0 .*got -1'),
    ('<spring joint="rail" stiffness="1" backlash="-1"/>', 'backlash must be >= 0 m, got -1'),
    ('<spring joint="elbow" stiffness="1" measured="both"/>', "one of motor, link, got 'both'"),
    ('<spring joint="elbow" stiffness="1" ratio="9"/>', "one of joint, stiff.*, got 'ratio'"),
    ('<actuator joint="elbow" armature="-1"/>', 'armature must be >= 0 kg m.*, got -1'),
]


def test_a_spring_belongs_to_its_joint() -> None:
    tree = robot(*LINKS, *JOINTS, block(GOOD, ROTORS))
    elbow, rail = (body.joint for body in tree.bodies)
    assert elbow is not None
    assert rail is not None
    assert elbow.spring == Spring(1.2e4, 8.0, measured='link')
    assert rail.spring is None
    assert tree.warnings == ()


@pytest.mark.parametrize(('text', 'message'), BAD)
def test_a_bad_spring_is_refused(text: str, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        robot(*LINKS, *JOINTS, block(text))


def test_mimic_joints_have_no_spring() -> None:
    mimic = JOINTS[1].replace('</joint>', '<mimic joint="elbow"/></joint>')
    spring = '<spring joint="rail" stiffness="1"/>'
    with pytest.raises(ModelError, match=r"joint must be no mimic joint.*leader, got 'rail'"):
        robot(*LINKS, JOINTS[0], mimic, JOINTS[2], block(spring))


def test_joints_of_loops_have_no_spring() -> None:
    joints = (*JOINTS[:2], joint('side', 'base', 'hand'))
    loop = '<loop name="pin" type="spherical"><parent link="slide"/><child link="hand"/></loop>'
    for name in ('elbow', 'side'):
        spring = f'<spring joint="{name}" stiffness="1"/>'
        rule = f"'{name}': joint must be outside of every loop, got one that 'pin' closes over"
        with pytest.raises(ModelError, match=rule):
            robot(*LINKS, *joints, block(loop, spring))
    # the loop lies beyond this joint
    before = (link('ground'), joint('turn', 'ground', 'base'))
    robot(*LINKS, *joints, *before, block(loop, '<spring joint="turn" stiffness="1"/>'))


def test_a_spring_without_a_rotor_is_warned_of() -> None:
    (warning,) = robot(*LINKS, *JOINTS, block(GOOD)).warnings
    assert warning.startswith("spring of joint 'elbow': armature of <actuator> should be > 0")


def test_overrides_reach_springs() -> None:
    tree = robot(*LINKS, *JOINTS, block(GOOD, ROTORS))
    values = values_of(tree)
    assert values['joint.elbow.stiffness'] == 1.2e4
    assert values['joint.elbow.spring_damping'] == 8.0
    assert values['joint.elbow.backlash'] == 0.0
    changed = with_overrides(
        tree,
        {
            'joint.elbow.stiffness': 2e4,
            'joint.elbow.spring_damping': 3.0,
            'joint.elbow.stiffness3': 5.0,
            'joint.elbow.backlash': 0.01,
        },
    )
    assert changed.bodies[0].joint is not None
    assert changed.bodies[0].joint.spring == Spring(2e4, 3.0, 5.0, 0.01, 'link')
    assert changed.bodies[0].joint.damping == 0.0
    with pytest.raises(ConfigError, match=r'joint.rail.<damping.friction.armature>'):
        with_overrides(tree, {'joint.rail.stiffness': 1.0})
