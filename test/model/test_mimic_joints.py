"""A mimic joint of a mimic joint follows the one that mimics none."""

from __future__ import annotations

from denoc_ros.model.reading.urdf import load_tree
from denoc_ros.model.tree import Mimic

MASS = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'


def joint(name: str, parent: str, child: str, mimic: str = '') -> str:
    return (
        f'<link name="{child}">{MASS}</inertial></link>'
        f'<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="0 0 1"/>{mimic}</joint>'
    )


def test_chains_of_mimic_joints_are_resolved() -> None:
    tree = load_tree(
        '<robot name="hand"><link name="base"/>'
        + joint('first', 'base', 'a', '<mimic joint="second" multiplier="2" offset="0.5"/>')
        + joint('second', 'a', 'b', '<mimic joint="third" multiplier="-3" offset="0.25"/>')
        + joint('third', 'b', 'c')
        + '</robot>'
    )
    # first = 2 (-3 third + 0.25) + 0.5
    assert tree.mimics == {
        'first': Mimic('third', -6.0, 1.0),
        'second': Mimic('third', -3.0, 0.25),
    }
    assert tree.non_mimic_joints == ('third',)
