"""What a floating joint may be in a file."""

from __future__ import annotations

import pytest
from small_robots import link

from denoc_ros.errors import ModelError
from denoc_ros.model.reading.urdf import load_tree


def afloat(name: str, parent: str, child: str, inner: str = '', kind: str = 'floating') -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'{inner}</joint>'
    )


def load(*parts: str) -> None:
    load_tree(f'<robot name="r"><link name="w"/>{link("a")}{link("b")}{"".join(parts)}</robot>')


AB = afloat('elbow', 'a', 'b', '<axis xyz="0 0 1"/>', 'continuous')
BAD = [
    (
        (afloat('root', 'w', 'a', kind='fixed'), afloat('f', 'a', 'b')),
        r"joint 'f': of type floating must be at the root: its parent .*, got 'a'",
    ),
    (
        (afloat('f', 'w', 'a'), afloat('g', 'w', 'b')),
        "floating joints must be at most one, got 'f', 'g'",
    ),
    (
        (afloat('f', 'w', 'a', '<mimic joint="elbow"/>'), AB),
        "joint 'f': of type floating must not be a mimic joint",
    ),
    (
        (
            afloat('f', 'w', 'a'),
            afloat('elbow', 'a', 'b', '<axis xyz="0 0 1"/><mimic joint="f"/>', 'continuous'),
        ),
        "joint of <mimic> must be a movable joint of the robot, got 'f'",
    ),
    (
        (afloat('f', 'w', 'a', '<dynamics damping="0.1"/>'), AB),
        "joint 'f': damping of <dynamics> must be 0 in a floating joint, got '0.1'",
    ),
    (
        (
            afloat('f', 'w', 'a'),
            AB,
            '<flexibility><actuator joint="f" armature="1"/></flexibility>',
        ),
        "joint must be a movable joint of the robot, got 'f'",
    ),
    (
        (afloat('f', 'w', 'a', kind='planar'), AB),
        'type must be one of fixed, .*floating .planar joints are not supported yet.',
    ),
]


@pytest.mark.parametrize(('parts', 'message'), BAD)
def test_a_wrong_floating_joint_is_a_finding(parts: tuple[str, ...], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        load(*parts)


def test_zero_damping_and_limits_of_a_floating_joint_are_read_over() -> None:
    load(afloat('f', 'w', 'a', '<dynamics damping="0.0"/><limit effort="0" velocity="0"/>'), AB)
