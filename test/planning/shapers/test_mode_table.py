"""Shapers that know a robot by an accelerometer alone: its modes at some postures, no beams."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from shaped_runs import cycloid, held_spline, swing_after

import denoc_ros as dn
from denoc_ros.cli.main import main
from denoc_ros.errors import ConfigError, StateError
from denoc_ros.model.mode_table import ModeTable, read_mode_table
from denoc_ros.types import Array

GANTRY = """<robot name="gantry">
  <link name="frame"/>
  <link name="bridge"><inertial><mass value="2"/>
    <inertia ixx="0.05" ixy="0" ixz="0" iyy="0.05" iyz="0" izz="0.05"/></inertial></link>
  <link name="head"><inertial><mass value="0.4"/>
    <inertia ixx="1e-3" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/></inertial></link>
  <joint name="y" type="prismatic"><parent link="frame"/><child link="bridge"/>
    <axis xyz="0 1 0"/><limit lower="0" upper="0.3" effort="5000" velocity="50"/></joint>
  <joint name="x" type="prismatic"><parent link="bridge"/><child link="head"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.3" effort="5000" velocity="50"/></joint>
</robot>"""
CORNERS = [(0.05, 0.05), (0.25, 0.05), (0.15, 0.15), (0.05, 0.25), (0.25, 0.25)]  # x, y
JOG = 0.002  # m
START, END = np.array([0.05, 0.05]), np.array([0.25, 0.25])  # y, x: the order of the URDF
DURATION = 0.08  # s: one and a half periods, so that much is left to shape


def frame_mode(x: Any, y: Any) -> tuple[Any, Any]:
    """Return the frequency [Hz] and damping ratio with which the printer's frame rings."""
    return 22.0 / np.sqrt(1.0 + 9.0 * y**2 + 0.6 * x), 0.02 + 0.04 * x


def head_motion(t: Array, axes: Any, along: Array) -> Array:
    """Return the head's acceleration (k,) [m/s^2] on a frame that gives way: Runge and Kutta."""
    step = float(t[1] - t[0])
    fine = t[0] + 0.5 * step * np.arange(2 * len(t) - 1)  # and the middles of the steps
    y, x = axes(fine).T
    frequency, zeta = frame_mode(x, y)
    rate, push = 2.0 * np.pi * frequency, -axes(fine, 2) @ along
    damping, stiffness = (2.0 * zeta * rate).tolist(), (rate**2).tolist()

    def slope(k: int, u: float, v: float) -> float:
        return float(push[k] - damping[k] * v - stiffness[k] * u)

    u = v = 0.0
    felt = np.empty(len(t))
    for k in range(0, 2 * len(t) - 1, 2):
        felt[k // 2] = a1 = slope(k, u, v)
        if k + 2 < len(fine):
            v2 = v + 0.5 * step * a1
            a2 = slope(k + 1, u + 0.5 * step * v, v2)
            v3 = v + 0.5 * step * a2
            a3 = slope(k + 1, u + 0.5 * step * v2, v3)
            v4 = v + step * a3
            a4 = slope(k + 2, u + step * v3, v4)
            u += step / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
            v += step / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    return np.asarray(felt - push[::2])


def gantry_swing(axes: Any, end: float) -> float:
    """Return the largest acceleration of the head after a motion has ended [m/s^2]."""
    t = np.linspace(0.0, end + 0.4, int(4000 * (end + 0.4)))
    return float(np.abs(head_motion(t, axes, np.array([1.0, 0.3])))[t > end + 1e-3].max())


def accelerometer_file(path: Path, x: float, y: float, draw: np.random.Generator) -> Path:
    """Write what an accelerometer on the head shows when a jog at a posture has ended."""
    t = np.arange(0.0, 1.0, 1.0 / 800.0)
    begin = np.linspace(0.0, 0.04, 40)
    axes = held_spline(begin, np.array([y, x]) + JOG * (cycloid(begin, 0.04)[:, None] - 1.0))
    values = 1e3 * head_motion(t, axes, np.array([1.0, 0.3]))
    with path.open('w', newline='') as stream:
        stream.write('#time,accel_x,accel_y,accel_z\n')  # as firmware of printers writes it
        noise = draw.normal(size=(t.size, 3)) * 10.0
        rows = np.column_stack([t + 51.2, noise[:, 0], values + noise[:, 1], 9810 + noise[:, 2]])
        csv.writer(stream).writerows(rows.tolist())
    return path


@pytest.fixture(scope='module')
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the table that the commands make of accelerometer files at five postures."""
    folder, draw = tmp_path_factory.mktemp('gantry'), np.random.default_rng(4)
    results = []
    for k, (x, y) in enumerate(CORNERS):
        file = accelerometer_file(folder / f'posture_{k}.csv', x, y, draw)
        results.append(str(folder / f'result_{k}'))
        arguments = ['identify', 'modal', str(file), '--field', 'accel_y', '--begin', '0.05']
        at = ['--at', f'x={x}', '--at', f'y={y}']
        assert main([*arguments, *at, '-o', results[-1]]) == 0
    table = folder / 'modes.yaml'
    assert main(['identify', 'postures', *results, '-o', str(table)]) == 0
    return table


def test_an_accelerometer_at_five_postures_stills_a_gantry_whose_beams_nobody_knows(
    measured: Path,
) -> None:
    gantry, table = dn.load_robot(GANTRY), read_mode_table(measured)
    for (x, y), found in zip(CORNERS, table.frequencies[:, 0], strict=True):
        assert found == pytest.approx(frame_mode(x, y)[0], rel=2e-3)
    t = np.linspace(0.0, DURATION, 61)
    q = START + (END - START) * cycloid(t, DURATION)[:, None]
    plain = gantry_swing(held_spline(t, q), DURATION)
    left = {}
    first = ModeTable(table.joints, table.positions[:1], table.frequencies[:1], table.ratios[:1])
    for name, given in (('all', str(measured)), ('first posture', first)):
        plan = dn.shape_motion(gantry, t, q, 'zv', mode_table=given, output_step=0.001)
        left[name] = gantry_swing(held_spline(plan.t, plan.q), float(plan.t[-1])) / plain
        assert plan.t[-1] == pytest.approx(DURATION + plan.delay)
    assert left['all'] < 0.06, left
    assert left['first posture'] > 4.0 * left['all'], left


@pytest.mark.long
def test_an_arm_is_stilled_by_its_tip_s_accelerometer_with_a_rigid_urdf() -> None:
    text = Path('config/robots/two_link_ff.urdf').read_text(encoding='utf-8')
    truth = dn.load_robot(
        text.replace(' shape="clamped-free"', ' segments="2"'), gravity=(0, 0, 0)
    )
    rigid = dn.load_robot(text[: text.index('<flexibility>')] + '</robot>', gravity=(0, 0, 0))
    draw, rows = np.random.default_rng(2), []
    elbows = (0.0, 1.0)
    for elbow in elbows:
        still = {name: (lambda _, q=q: (q, 0.0, 0.0)) for name, q in
                 zip(truth.joint_names, (0.0, elbow), strict=True)}  # fmt: skip
        start = truth.static_deflection([0.0, elbow], {'tool': np.eye(6)[1] * 20.0})
        t = np.arange(0.0, 2.0, 0.005)
        run = dn.simulate(truth, start, np.zeros(truth.n), t, prescribed=still, rtol=1e-6)
        tip = truth.frame_pose('tool', run.q)[:, 1, 3]
        felt = np.gradient(np.gradient(tip, t), t)[4:-4]
        felt += draw.normal(size=felt.size) * 2e-3 * np.abs(felt).max()
        modes = dn.identify_modes(t[4:-4], felt)
        strongest = np.sort(np.argsort(modes.energy)[::-1][:2])
        rows.append((modes.frequency[strongest], modes.damping_ratio[strongest]))
    table = ModeTable(
        (truth.joint_names[1],),
        np.array(elbows)[:, None],
        np.array([frequency for frequency, _ in rows]),
        np.maximum([ratio for _, ratio in rows], 0.0),
    )
    t = np.linspace(0.0, 0.8, 201)
    q = np.outer(cycloid(t, 0.8), [1.0, 1.0])
    plain = swing_after(truth, t, q, 'tool', watch=0.5)
    plan = dn.shape_motion(rigid, t, q, 'zvd', mode_table=table)
    left = swing_after(truth, plan.t, plan.q, 'tool', watch=0.5) / plain
    assert left < 0.06, left


def test_between_postures_modes_are_the_table_s_and_their_order_does_not_matter() -> None:
    draw = np.random.default_rng(7)
    positions = draw.uniform(-2.0, 2.0, (7, 2))
    frequencies = np.sort(draw.uniform(3.0, 9.0, (7, 2)), axis=1)
    ratios = draw.uniform(0.0, 0.1, (7, 2))
    table = ModeTable(('a', 'b'), positions, frequencies, ratios)
    other = ModeTable(('b', 'a'), positions[::-1, ::-1], frequencies[::-1], ratios[::-1])
    for row in range(7):
        here = table.at(['c', 'a', 'b'], np.r_[9.0, positions[row]])
        np.testing.assert_allclose(here, (frequencies[row], ratios[row]), rtol=1e-9)
    for place in draw.uniform(-3.0, 3.0, (20, 2)):
        found = table.at(['a', 'b'], place)
        np.testing.assert_allclose(other.at(['a', 'b'], place), found, rtol=1e-9)
        assert (
            (found[0] >= frequencies.min(axis=0)) & (found[0] <= frequencies.max(axis=0))
        ).all()
    line = ModeTable(('a',), np.array([[0.0], [2.0]]), np.array([[4.0], [9.0]]), np.zeros((2, 1)))
    halfway, beyond = (line.at(['a'], np.array([a]))[0][0] for a in (1.0, 5.0))
    assert (halfway, beyond) == (pytest.approx(6.0), pytest.approx(9.0))  # the geometric mean


GOOD: dict[str, Any] = {
    'joints': ['x'],
    'postures': [
        {'position': [0.0], 'frequency': [3.0, 8.0], 'damping_ratio': [0.01, 0.0]},
        {'position': [0.1], 'frequency': [4.0, 9.0], 'damping_ratio': [0.01, 0.0]},
    ],
}


@pytest.mark.parametrize(
    ('key', 'value', 'rule'),
    [
        ('position', [0.0], 'position must differ from posture to posture, got one twice'),
        ('position', [0.1, 2.0], r"position must have one number for each of \['x'\]"),
        ('frequency', [9.0, 4.0], 'frequency must ascend at each posture'),
        ('frequency', [0.0, 4.0], 'frequency must be > 0 Hz'),
        ('frequency', [4.0], 'must have as many numbers as those of all postures'),
        ('frequency', ['fast', 4.0], 'frequency must be a list of numbers'),
        ('damping_ratio', [1.0, 0.0], 'damping_ratio must be >= 0 and < 1'),
        ('damping_ratio', None, 'damping_ratio must be a list of numbers'),
    ],
)
def test_a_bad_table_is_refused_with_its_place(
    tmp_path: Path, key: str, value: Any, rule: str
) -> None:
    file = tmp_path / 'modes.yaml'
    last = {**GOOD['postures'][1], key: value}
    file.write_text(yaml.safe_dump({**GOOD, 'postures': [GOOD['postures'][0], last]}))
    with pytest.raises(ConfigError, match=rule):
        read_mode_table(file)


def test_a_table_is_for_input_shapers_and_for_the_robot_s_joints() -> None:
    gantry = dn.load_robot(GANTRY)
    t, q = np.array([0.0, 0.5]), np.array([START, END])
    rows = np.array([[0.0]]), np.array([[20.0]]), np.array([[0.01]])
    with pytest.raises(StateError, match="mode_table must be for 'zv', 'zvd' or 'ei'"):
        dn.shape_motion(gantry, t, q, 'rest_to_rest', mode_table=ModeTable(('x',), *rows))
    with pytest.raises(ConfigError, match=r"joints must be of the robot \(y, x\), got \['z'\]"):
        dn.shape_motion(gantry, t, q, 'zv', mode_table=ModeTable(('z',), *rows))


def test_results_without_a_posture_make_no_table(
    measured: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = yaml.safe_load((measured.parent / 'result_0' / 'result.yaml').read_text())
    result.pop('model')
    bad = tmp_path / 'result.yaml'
    bad.write_text(yaml.safe_dump(result))
    assert main(['identify', 'postures', str(bad), '-o', str(tmp_path / 'modes.yaml')]) == 1
    assert 'result must be of `denoc identify modal` with a posture' in capsys.readouterr().err
    assert not (tmp_path / 'modes.yaml').exists()


def test_a_doubtful_mode_makes_no_table_unless_asked_for(
    measured: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = yaml.safe_load((measured.parent / 'result_0' / 'result.yaml').read_text())
    result['modes'][0]['verdict'] = 'doubtful'
    doubtful, table = tmp_path / 'result.yaml', str(tmp_path / 'modes.yaml')
    doubtful.write_text(yaml.safe_dump(result))
    postures = ['identify', 'postures', str(doubtful), '-o', table]
    assert main(postures) == 1
    assert 'doubtful: --doubtful takes them' in capsys.readouterr().err
    assert main([*postures, '--doubtful']) == 2
    assert Path(table).exists()
