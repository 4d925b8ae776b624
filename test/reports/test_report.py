"""The report: known numbers come out, on one page that needs nothing else."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from page_look import require_one_look

from denoc_ros.bags.writer import BagWriter
from denoc_ros.cli.main import main
from denoc_ros.pages.figures import scale_of, thin
from denoc_ros.pages.html_page import engineering
from denoc_ros.reports.run_page import report

# What test/support/runs/recorded_run_fixtures.py puts in, as rms of a sine.
TRACKING = {'rigid': 0.02, 'flexible': 0.001}
DEFLECTION, MISSED = 0.05, 0.1

Maker = Callable[[], Path]


def test_known_errors_come_out(recorded_run: Maker) -> None:
    summary = report(recorded_run()).summary
    for name, amplitude in TRACKING.items():
        phase = summary['phases'][name]
        # the reference is quadratic: its spline is exact, the stamps are whole nanoseconds
        for joint in ('j1', 'j2'):
            assert phase['joint_error'][joint]['rms'] == pytest.approx(amplitude / 2**0.5, 1e-6)
            assert phase['joint_error'][joint]['max'] == pytest.approx(amplitude, 1e-6)
        error = phase['deflection_error']['arm/uy']
        assert error['rms'] == pytest.approx(MISSED * DEFLECTION / 2**0.5, 1e-6)
        assert error['percent_of_peak'] == pytest.approx(100.0 * MISSED / 2**0.5, 1e-6)
        assert 'arm/ux' not in phase['deflection_error']
    # two phases of 2 s and a second between: five stretches of 2000 ticks, 10 of them late
    loop = summary['loops']['feedforward']
    assert (loop['ticks'], loop['late'], loop['skipped']) == (10_000, 50, 5)


def test_page_is_whole_and_needs_nothing_else(recorded_run: Maker) -> None:
    run = recorded_run()
    assert main(['report', str(run)]) == 0
    page = (run / 'report.html').read_text()
    for heading in ('Tracking error', 'Deflection', 'Feedforward torque', 'Loop periods'):
        assert f'{heading}' in page
    # two joints, a deflection in each phase, two torques, a loop
    assert len(re.findall('<figure>', page)) == 7
    require_one_look(page, str(run))
    assert len(page) < 1_500_000


def test_json_is_the_summary(recorded_run: Maker, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['report', str(recorded_run()), '--json']) == 0
    assert set(json.loads(capsys.readouterr().out)['phases']) == set(TRACKING)


def test_a_bag_of_nothing_but_joints_gives_a_page(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'plain.mcap') as bag:
        bag.add_topic('/arm/joint_states', 'sensor_msgs/msg/JointState')
        for k in range(20):
            bag.write_message(
                '/arm/joint_states', 10**9 + k * 10**7, name=['j1'], position=[0.1 * k]
            )
    output = tmp_path / 'page.html'
    assert main(['report', str(tmp_path / 'plain.mcap'), '-o', str(output)]) == 0
    assert '<h2>Joint motion</h2>' in output.read_text()
    require_one_look(output.read_text(), str(tmp_path))


def test_names_of_topics_and_joints_are_escaped(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'odd.mcap') as bag:
        bag.add_topic('/joint_states', 'sensor_msgs/msg/JointState')
        for k in range(3):
            name = ['<script>alert(1)</script>']
            bag.write_message('/joint_states', 10**9 + k * 10**7, name=name, position=[0.1 * k])
    page = report(tmp_path / 'odd.mcap').html()
    assert '<script' not in page


@pytest.mark.parametrize('kind', ['absent', 'empty', 'foreign'])
def test_what_is_no_run_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    path = tmp_path / 'bag.mcap'
    if kind == 'foreign':
        path.write_bytes(b'not a bag')
    elif kind == 'empty':
        with BagWriter(path) as bag:
            bag.add_topic('/odometry', 'nav_msgs/msg/Odometry')
    assert main(['report', str(path)]) == 1
    assert re.search(r'denoc report: .*bag.mcap: (run|bag) must', capsys.readouterr().err)


@pytest.mark.parametrize(
    ('session', 'match'),
    [
        ('{', 'session.json must be JSON'),
        ('[' * 100_000, 'session.json must be JSON'),
        ('{"name": "\\ud800"}', 'session.json must be JSON'),
        ('{"other": NaN}', 'session.json must be JSON'),
        ('[1]', r'session.json: the document must be a mapping, got \[1\]'),
        (
            '{"gravity": "down", "model": 3}',
            r'(?s)session.json: gravity must be three finite .*json: model must be a mapping',
        ),
        ('{"gravity": [0, 0]}', r'gravity must be three finite numbers \[m/s\^2\], got \[0, 0\]'),
        ('{"phases": [{"name": 1}]}', r'phases\[0\].name must be a text, got 1'),
        ('{"phases": [3]}', r'phases\[0\] must be a mapping, got 3'),
        ('{"phases": {}}', 'phases must be a list'),
        (
            '{"phases": [{"name": "a", "begin_ns": "z"}]}',
            r"phases\[0\].begin_ns must be a whole number of ns .*, got 'z'",
        ),
        (
            '{"phases": [{"name": "a", "begin_ns": 5, "end_ns": 4}]}',
            r'phases\[0\].end_ns must be 5 or more, got 4',
        ),
        ('{"time": {"begun_ns": "z"}}', 'time.begun_ns must be a whole number of ns'),
        ('{"time": {"factor": "fast"}}', 'time.factor must be a finite number'),
        ('{"plant": {"joint.j1.damping": {}}}', 'plant.joint.j1.damping must be a number, a text'),
        ('{"versions": {"python": 3}}', 'versions.python must be a text, got 3'),
    ],
)
def test_a_session_that_is_none_is_refused(
    recorded_run: Maker, capsys: pytest.CaptureFixture[str], session: str, match: str
) -> None:
    run = recorded_run()
    (run / 'session.json').write_text(session)
    for verb in ('report', 'view', 'replay'):
        arguments = {'view': ['--strip', str(run / 'strip.png')]}.get(verb, [])
        assert main([verb, str(run), *arguments]) == 1
        said = capsys.readouterr().err
        assert re.search(match, said), said
        assert 'Traceback' not in said


def test_thinning_keeps_the_extremes() -> None:
    t = np.linspace(0.0, 1.0, 10_000)
    y = np.sin(40.0 * t)
    y[5_123] = 7.0
    thin_t, thin_y = thin(t, y, 100)
    assert len(thin_t) <= 202
    assert thin_y.max() == 7.0
    assert (thin_t[0], thin_t[-1]) == (0.0, 1.0)


def test_numbers_carry_a_prefix() -> None:
    assert engineering(0.00123, 'rad') == '1.23 mrad'
    assert engineering(12345.0, 'N m') == '12.3 kN m'
    assert engineering(0.0, 'm') == '0 m'
    assert engineering(0.00099961, 's') == '1 ms'
    assert scale_of([np.array([0.002, -0.05])]) == (1e-3, 'm')
