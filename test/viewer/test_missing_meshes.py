"""Meshes that are nowhere are told in one line."""

from __future__ import annotations

import logging

import pytest

import denoc_ros as dn
from denoc_ros.viewer.outline import outlines

LINK = (
    '<link name="l{k}"><visual><geometry><mesh filename="package://none/l{k}.stl"/></geometry>'
    '</visual><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" '
    'iyz="0"/></inertial></link>'
)
JOINT = (
    '<joint name="j{k}" type="continuous"><parent link="l{before}"/><child link="l{k}"/>'
    '<origin xyz="1 0 0"/><axis xyz="0 0 1"/></joint>'
)


def test_missing_meshes_are_one_line_with_a_count(caplog: pytest.LogCaptureFixture) -> None:
    links = ''.join(LINK.format(k=k) for k in range(11))
    joints = ''.join(JOINT.format(k=k, before=k - 1) for k in range(1, 11))
    robot = dn.load_robot(f'<robot name="arm">{links}{joints}</robot>')
    with caplog.at_level(logging.WARNING):
        outlines(robot)
        outlines(robot)
    lines = [record.getMessage() for record in caplog.records if 'mesh' in record.getMessage()]
    assert len(lines) == 1
    assert 'none for 11 of 11, drawn as beams and rods: package://none/l0.stl, ' in lines[0]
