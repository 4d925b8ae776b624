"""Every page has the one look, and says in a sentence what it comes down to."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lxml import html
from numpy.typing import NDArray
from page_look import contrast, require_one_look

from denoc_ros.cli.main import main
from denoc_ros.pages.html_page import Card, PageSection, PageTable, ReportPage, Verdict
from denoc_ros.pages.provenance import command_line
from denoc_ros.reports.run_page import report

Array = NDArray[Any]

FALL = (
    'start: {joints: [0.6]}\nduration: 0.4\ngravity: [0, -9.81, 0]\n'
    'model: {joint.joint_1.damping: 0, payload.link_1.mass: 0.5,\n'
    '  payload.link_1.com: [1, 0, 0]}\n'
)
FOUR_BAR_FALL = 'duration: 0.05\noutput_rate: 200\n'


def write_table(path: Path, **columns: Array) -> Path:
    with path.open('w', newline='') as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    return path


def simulated(robot: Path, scenario: str, tmp_path: Path) -> str:
    """Return the page that `denoc simulate` writes beside its bag."""
    file = tmp_path / 'fall.yaml'
    file.write_text(scenario)
    output, page = tmp_path / 'run.mcap', tmp_path / 'run.html'
    arguments = ['simulate', str(robot), str(file), '-o', str(output), '--report', str(page)]
    assert main(arguments) == 0
    return page.read_text()


@pytest.mark.long
def test_simulation_conserves_what_its_page_says(repository: Path, tmp_path: Path) -> None:
    robot = repository / 'config' / 'robots' / 'rigid_pendulum.urdf'
    page = simulated(robot, FALL, tmp_path)
    require_one_look(page, str(tmp_path), str(repository))
    for heading in ('Joint motion', 'Torque', 'Energy'):
        assert f'<h2>{heading}</h2>' in page
    assert 'denoc simulate rigid_pendulum.urdf fall.yaml -o run.mcap --report run.html' in page
    summary = report(tmp_path / 'run.mcap').summary
    found = summary['simulated']
    # nothing is lost by a pendulum without friction: the integrator's tolerance of 1e-8 per step;
    # with another gravity, or without the payload of the run, the total energy would change
    assert found['largest_kinetic_energy'] > 0.1
    assert found['largest_energy_change'] < 1e-6 * found['largest_kinetic_energy']
    assert found['closure_error'] is None


@pytest.mark.long
def test_page_of_a_mechanism_says_how_its_loops_close(repository: Path, tmp_path: Path) -> None:
    robot = repository / 'config' / 'robots' / 'four_bar_rrr.urdf'
    page = simulated(robot, FOUR_BAR_FALL, tmp_path)
    require_one_look(page, str(tmp_path))
    assert 'its loops stay closed to' in page
    assert '<h2>Closed loops</h2>' in page


def test_one_page_is_not_of_many_runs(
    repository: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = repository / 'config' / 'robots' / 'single_link.urdf'
    scenario = repository / 'config' / 'scenarios' / 'single_link.yaml'
    arguments = ['simulate', str(robot), str(scenario), '-o', str(tmp_path / 'rows')]
    arguments += ['--vary', 'beam.link_1.y.ei=300:400', '--report', str(tmp_path / 'page.html')]
    assert main(arguments) == 1
    assert 'the page is of one run, got --vary' in capsys.readouterr().err


@pytest.mark.long
def test_page_of_a_swing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    t = np.arange(300) * 0.02
    angle: Array = 0.3 * np.exp(-0.3 * t) * np.cos(2.0 * np.pi * t)
    angle += 1e-3 * np.random.default_rng(4).standard_normal(len(t))
    swing = write_table(tmp_path / 'swing.csv', time=t, angle=angle)
    arguments = ['identify', 'joint', str(swing), '--field', 'angle', '--spring']
    assert main([*arguments, '-o', str(tmp_path / 'out'), '--json']) in (0, 2)
    assert json.loads(capsys.readouterr().out)['terms']
    page = (tmp_path / 'out' / 'report.html').read_text()
    require_one_look(page, str(tmp_path))
    assert '<h2>Which terms matter</h2>' in page


@pytest.mark.parts('identification')
def test_page_of_a_forced_response(tmp_path: Path) -> None:
    t = np.arange(500) * 0.005
    draw = np.random.default_rng(5)
    force = draw.standard_normal(len(t))
    answer = np.zeros_like(force)
    # a mode at 5 Hz with damping ratio 0.02, by its exact difference equation
    radius, turn = np.exp(-0.02 * 2 * np.pi * 5.0 * 0.005), 2 * np.pi * 5.0 * 0.005
    for k in range(2, len(t)):
        answer[k] = 2 * radius * np.cos(turn) * answer[k - 1] - radius**2 * answer[k - 2]
        answer[k] += force[k - 1]
    answer += 0.01 * np.std(answer) * draw.standard_normal(len(t))
    record = write_table(tmp_path / 'shaken.csv', time=t, u=force, y=answer)
    arguments = ['identify', 'forced', str(record), '--field', 'y', '--force-field', 'u']
    assert main([*arguments, '-o', str(tmp_path / 'out')]) in (0, 2)
    page = (tmp_path / 'out' / 'report.html').read_text()
    require_one_look(page, str(tmp_path))
    shown = html.fromstring(page).text_content().replace('\xa0', ' ')
    assert re.search(r'modes?: (5|5\.0\d*|4\.9\d*) Hz with ζ 0\.0(19|2)', shown)


def test_texts_are_escaped() -> None:
    odd = '<b>"&'
    page = ReportPage(
        odd,
        odd,
        Verdict(odd, 'bad'),
        [Card(odd, odd, odd)],
        [
            PageSection(
                odd, odd, tables=[PageTable((odd, odd), [(odd, odd)], folded=True, title=odd)]
            )
        ],
        {odd: odd},
    ).html()
    assert odd not in page
    assert page.count('&lt;b&gt;&#34;&amp;') >= 12


def test_command_has_names_of_files_but_no_folders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'runs').mkdir()
    given = [str(tmp_path / 'a b.urdf'), 'runs/one', f'--robot={tmp_path}/new/arm.urdf']
    assert command_line(['replay', *given]) == "denoc replay 'a b.urdf' one --robot=arm.urdf"
    # topics and fields have slashes too
    topics = ['--topic', '/plant/true_deflection', '--field', 'link_1/uy']
    assert command_line(topics) == f'denoc {" ".join(topics)}'


def test_contrast_is_that_of_the_standard() -> None:
    assert contrast('#000000', '#ffffff') == pytest.approx(21.0)
    # the standard's own borderline grey on white
    assert contrast('#767676', '#ffffff') == pytest.approx(4.54, abs=0.01)


@pytest.mark.parametrize(
    ('text', 'whole'),
    [
        ('a tip of 0.15 mm at 3.2e-5 N m s/rad', ['0.15 mm', '3.2e-5 N m s/rad']),
        ('5 rad/s² and 12 °/s', ['5 rad/s²', '12 °/s']),
        ('2 kg m², 7800 kg/m^3, 210 GPa', ['2 kg m²', '7800 kg/m^3', '210 GPa']),
        ('found, ± 0.3 N m', ['± 0.3 N m']),
        ('3 modes of 40 samples', []),
    ],
)
def test_a_number_stays_with_its_whole_unit_in_all_texts_of_a_page(
    text: str, whole: list[str]
) -> None:
    """Running text wrapped between a number and its unit, and within `rad/s²`."""
    page = ReportPage(text, text, Verdict(text), [Card('c', text, text)], [PageSection('s', text)])
    kept = re.findall('<span class="quantity">(.*?)</span>', page.html())
    assert kept == 5 * whole  # subtitle, verdict, value and note of the card, text of the section
