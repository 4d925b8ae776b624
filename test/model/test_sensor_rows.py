"""Sensors' rows against the statics of a cantilever."""

from __future__ import annotations

import numpy as np
import pytest

from denoc_ros.model.reading.urdf import load_tree
from denoc_ros.model.tree import Tree
from denoc_ros.types import Array

LENGTH, EI, SURFACE = 2.0, 50.0, 0.01


def cantilever(sensors: str, shape: str = 'craig-bampton') -> Tree:
    """Return a beam whose shapes contain the tip load's static deflection exactly."""
    return load_tree(f"""<robot name="r"><link name="base"/><link name="arm">
      <inertial><origin xyz="1 0 0"/><mass value="3"/><inertia ixx="0" iyy="1" izz="1"/></inertial>
      </link><joint name="j" type="revolute"><parent link="base"/><child link="arm"/></joint>
      <flexibility><beam link="arm" length="{LENGTH}" shape="{shape}">
      <bending direction="y" ei="{EI}" modes="3"/><bending direction="z" ei="{EI}" modes="2"/>
      </beam>{sensors}</flexibility></robot>""")


def amplitudes(tree: Tree, direction: str, force: float) -> Array:
    """Return the amplitudes under a force at the tip along a direction."""
    beam = tree.bodies[0].beam
    assert beam is not None
    part = beam.y if direction == 'y' else beam.z
    assert part is not None
    tip = part.shapes.values(np.array([LENGTH]))[0]
    d = np.zeros(sum(beam.modes))
    first = 0 if direction == 'y' else beam.modes[0]
    d[first : first + part.modes] = force * tip / part.modal_stiffness
    return d


@pytest.mark.parametrize('direction', ['y', 'z'])
def test_rows_say_what_a_tip_force_does(direction: str) -> None:
    sign = -1.0 if direction == 'y' else 1.0
    at = f'link="arm" direction="{direction}"'
    tree = cantilever(
        f'<sensor name="g" type="strain_gauge" {at} station="0.5" surface="{SURFACE}"/>'
        f'<sensor name="m" type="load_cell" {at} station="0.5" component="moment"/>'
        f'<sensor name="s" type="load_cell" {at} station="0.5" component="shear"/>'
        f'<sensor name="u" type="deflection" {at} station="{LENGTH}"/>'
    )
    force = 3.0
    d = amplitudes(tree, direction, force)
    gauge, moment, shear, deflection = (float(sensor.row @ d) for sensor in tree.sensors)
    bending = force * (LENGTH - 0.5)
    assert gauge == pytest.approx(-SURFACE * bending / EI, rel=1e-12)
    # The inboard part holds the outboard one: force against the load, moment r x F reversed.
    assert moment == pytest.approx(sign * bending, rel=1e-12)
    assert shear == pytest.approx(-force, rel=1e-12)
    assert deflection == pytest.approx(force * LENGTH**3 / (3.0 * EI), rel=1e-12)


def test_gain_and_offset_calibrate_the_raw_reading_and_not_the_row() -> None:
    at = 'type="deflection" link="arm" direction="y" station="1"'
    tree = cantilever(
        f'<sensor name="a" {at}/>'
        f'<sensor name="b" {at} gain="-2" offset="0.5" noise="0.1" topic="/b" field="2"/>'
    )
    plain, calibrated = tree.sensors
    np.testing.assert_array_equal(calibrated.row, plain.row)
    assert (calibrated.offset, calibrated.noise, calibrated.topic, calibrated.field) == (
        0.5,
        0.1,
        '/b',
        '2',
    )
    assert (plain.gain, plain.offset, plain.noise, plain.topic) == (1.0, 0.0, 0.0, '')
    assert (plain.body, plain.link) == (0, 'arm')


def test_a_station_beyond_the_tip_is_the_tip_with_a_warning() -> None:
    at = 'type="deflection" link="arm" direction="y"'
    tree = cantilever(f'<sensor name="a" {at} station="2"/><sensor name="b" {at} station="2.5"/>')
    np.testing.assert_array_equal(tree.sensors[0].row, tree.sensors[1].row)
    assert len(tree.warnings) == 1
    assert "sensor 'b': station must be at most the length 2 m" in tree.warnings[0]


def test_a_row_leaves_the_other_deformations_alone() -> None:
    at = 'type="deflection" link="arm" station="1"'
    tree = cantilever(
        f'<sensor name="a" {at} direction="y"/><sensor name="b" {at} direction="z"/>',
        'clamped-free',
    )
    y, z = tree.sensors
    assert np.all(y.row[3:] == 0.0)
    assert np.all(z.row[:3] == 0.0)
    assert np.all(y.row[:3] != 0.0)
