"""Deflections and sensors of links of segments mean the whole link."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from segmented_robots import spatial_text
from strategies import random_state

import denoc_ros as dn
from denoc_ros.dynamics.elastic.deflection import CentreLine, TipDeflections
from denoc_ros.dynamics.rotations import rotations
from denoc_ros.errors import StateError
from denoc_ros.types import Array

Close = Callable[[Array, Array, float], None]

STATIONS = (0.1, 0.5, 0.95)  # m, in the first of three segments, the second, and the tip
BENT = 0.3  # m and rad of an amplitude: far beyond small deflections
SENSORS = ''.join(
    f'<sensor name="u{axis}{k}" type="deflection" link="upper" station="{x}" direction="{axis}"/>'
    for axis in 'yz'
    for k, x in enumerate(STATIONS)
)


def marked_arm() -> dn.Robot:
    """The spatial arm, with a frame on its upper link's beam at each station."""
    cosine, sine = math.cos(0.1), math.sin(0.1)
    marks = ''.join(
        f'<link name="mark{k}"/><joint name="at{k}" type="fixed"><parent link="upper"/>'
        f'<child link="mark{k}"/><origin xyz="{0.05 + cosine * x!r} {0.1 + sine * x!r} 0.02"'
        ' rpy="0 0 0.1"/></joint>'
        for k, x in enumerate(STATIONS)
    )
    text = spatial_text(3, SENSORS).replace('<flexibility>', f'{marks}<flexibility>')
    return dn.load_robot(text)


ARM = marked_arm()
BEAM = ARM.tree.bodies[0].frame


def moved(robot: dn.Robot, k: int, q: Array) -> tuple[Array, Array]:
    """Displacement and turn of a mark in the frame of the beam's root, by frames' poses."""
    seen = np.linalg.inv(robot.frame_pose('upper', q) @ BEAM) @ robot.frame_pose(f'mark{k}', q)
    return seen[:3, 3] - [STATIONS[k], 0.0, 0.0], seen[:3, :3]


@pytest.mark.parametrize('k', range(len(STATIONS)))
def test_a_deflection_is_what_frames_say(close: Close, k: int) -> None:
    q = random_state(ARM.coordinate_names, 1, BENT).q
    place, turn = moved(ARM, k, q)
    section, own = ARM.section('upper', STATIONS[k])
    found = section.deflection(q[own])
    close(ARM.tip_deflection('upper', q, STATIONS[k]), place, 1e-12)
    close(rotations(found[3:]), turn, 1e-12)


def test_rates_and_gradients_are_those_of_differences(close: Close) -> None:
    s = random_state(ARM.coordinate_names, 2, BENT)
    step = 2e-6
    shift = step * np.eye(ARM.n)
    for x in STATIONS:
        section, own = ARM.section('upper', x)
        rate = section.rate(s.q[own], s.qd[own])
        ahead, behind = (section.deflection((s.q + t * s.qd)[own]) for t in (step, -step))
        close(rate, (ahead - behind) / (2 * step), 1e-7)  # of central differences
        by_q = ARM.tip_deflection_jacobian('upper', s.q, x)
        columns = [
            (ARM.tip_deflection('upper', s.q + e, x) - ARM.tip_deflection('upper', s.q - e, x))
            / (2 * step)
            for e in shift
        ]
        close(by_q, np.array(columns).T, 1e-7)
        close(by_q @ s.qd, rate[:3], 1e-12)
        later, sooner = (
            ARM.tip_deflection_jacobian('upper', s.q + t * s.qd, x) for t in (step, -step)
        )
        changed = ARM.tip_deflection_jacobian_rate('upper', s.qd, x, q=s.q)
        close(changed, (later - sooner) / (2 * step), 1e-7)


def test_rows_of_states_are_those_of_single_ones(close: Close) -> None:
    rng = np.random.default_rng(3)
    q, qd = rng.uniform(-BENT, BENT, (2, 5, ARM.n))
    section, own = ARM.section('upper')
    for k in range(5):
        close(ARM.tip_deflection('upper', q)[k], ARM.tip_deflection('upper', q[k]), 1e-13)
        close(section.rate(q[:, own], qd[:, own])[k], section.rate(q[k, own], qd[k, own]), 1e-12)
        close(ARM.sensor_values(q)[k], ARM.sensor_values(q[k]), 1e-13)
        rows = ARM.tip_deflection_jacobian_rate('upper', qd, q=q)
        close(rows[k], ARM.tip_deflection_jacobian_rate('upper', qd[k], q=q[k]), 1e-12)


def test_the_jacobian_s_rate_needs_the_state() -> None:
    with pytest.raises(StateError, match="link 'upper': q must be given where it has segments"):
        ARM.tip_deflection_jacobian_rate('upper', np.zeros(ARM.n))


def test_tips_are_those_of_sections(close: Close) -> None:
    s, tips = random_state(ARM.coordinate_names, 4, BENT), TipDeflections(ARM)
    assert tips.links == ('upper', 'fore')
    position, rate = tips.evaluate(s.q, s.qd)
    for k, link in enumerate(tips.links):
        section, own = ARM.section(link)
        close(position[6 * k : 6 * k + 6], section.deflection(s.q[own]), 1e-13)
        close(rate[6 * k : 6 * k + 6], section.rate(s.q[own], s.qd[own]), 1e-13)


def test_tips_of_a_straight_arm_move_as_its_linear_part(close: Close) -> None:
    qd, tips = random_state(ARM.coordinate_names, 6, BENT).qd, TipDeflections(ARM)
    position, rate = tips.evaluate(np.zeros(ARM.n), qd)
    assert np.abs(position).max() < 1e-15  # m: of the sum of segments' lengths
    for k, link in enumerate(tips.links):
        section, own = ARM.section(link)
        close(rate[6 * k : 6 * k + 6], section.linear @ qd[own], 1e-14)


def test_the_centre_line_runs_through_the_frames(close: Close) -> None:
    q = random_state(ARM.coordinate_names, 5, BENT).q
    points, turns = CentreLine(ARM, 'upper', np.array(STATIONS)).place(q)
    for k, x in enumerate(STATIONS):
        place, turn = moved(ARM, k, q)
        close(points[k], place + [x, 0.0, 0.0], 1e-12)
        close(turns[k], turn, 1e-12)


def test_a_deflection_sensor_reads_the_displacement_in_the_beam_frame(close: Close) -> None:
    s = random_state(ARM.coordinate_names, 6, BENT)
    values = ARM.sensor_values(s.q)
    places = np.array([moved(ARM, k, s.q)[0] for k in range(len(STATIONS))])
    close(values, np.concatenate([places[:, 1], places[:, 2]]), 1e-12)
    step = 1e-5
    columns = [
        (ARM.sensor_values(s.q + e) - ARM.sensor_values(s.q - e)) / (2 * step)
        for e in step * np.eye(ARM.n)
    ]
    close(ARM.sensor_derivatives(s.q)[0], np.array(columns).T, 1e-7)
    rows = ARM.sensor_derivatives(np.array([s.q, 0.0 * s.q]))[0]
    close(rows[0], ARM.sensor_derivatives(s.q)[0], 1e-12)


def test_small_deflections_are_linear_in_the_sensor_s_row(close: Close) -> None:
    straight = ARM.sensor_derivatives(np.zeros(ARM.n))[0]
    for row, sensor in zip(straight, ARM.tree.sensors, strict=True):
        first = ARM.amplitudes('upper').start
        close(row[first : first + len(sensor.row)], sensor.row, 1e-12)
        assert not row[first + len(sensor.row) :].any()


def test_amplitudes_of_a_link_are_those_of_its_segments() -> None:
    own = ARM.amplitudes('upper')
    names = ARM.coordinate_names[own]
    assert names[0] == 'upper/y1'
    assert names[-1] == 'upper/3/t2'
    assert ARM.coordinate_names[ARM.amplitudes('upper/2')][0] == 'upper/2/y1'
    with pytest.raises(StateError, match=r"one of \['upper', 'fore'\], got 'hand'"):
        ARM.amplitudes('hand')
