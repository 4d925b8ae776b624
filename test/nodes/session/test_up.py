"""`denoc up` as its user runs it: processes on real DDS, phases, recording, a clean end."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from page_look import require_one_look
from viewer_client import ViewerClient

from denoc_ros.bags.reader import bag_topics, read_attachment
from denoc_ros.cli.main import main
from denoc_ros.parts import node_main, nodes

pytestmark = pytest.mark.ros

ROOT = Path(__file__).resolve().parents[3]
CANADARM = str(ROOT / 'config' / 'canadarm.yaml')
# A rate that a loaded machine keeps: how evenly the loops run is not what is tested here.
SLOW = [f'--set=nodes.{name}.update_rate=250' for name in ('plant', 'feedforward', 'predictor')]
PLANT_ONLY = ['--set=nodes.predictor=false', '--set=nodes.feedforward=false']
RECORDED = 300_000  # bytes: a second of the plant's topics
BOUND = 240.0  # s: with a cold kernel cache on a slow machine


def up(*arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, '-m', 'denoc_ros.cli.main', 'up', '--time', 'real', *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )


def finish(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    try:
        out, err = process.communicate(timeout=BOUND)
    finally:
        process.kill()
    return process.returncode, out, err


def nodes_below(folder: Path) -> list[int]:
    """Return the processes that were started for a run's directory."""
    found, modules = [], [node_main(node) for node in nodes()]
    for entry in Path('/proc').iterdir():
        if entry.name.isdigit():
            try:
                command = (entry / 'cmdline').read_bytes().decode()
            except OSError:
                continue
            if str(folder) in command and any(each in command for each in modules):
                found.append(int(entry.name))
    return found


def wait_for_recording(run: Path) -> None:
    """Wait until joint states are in the bag: nothing else there fills so much in a second."""
    end = time.perf_counter() + BOUND
    while sum(file.stat().st_size for file in (run / 'bag').glob('*.mcap')) < RECORDED:
        assert time.perf_counter() < end, 'the recording must grow'
        time.sleep(0.1)


def test_both_feedforwards_run_are_recorded_and_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / 'run'
    arguments = ['--duration', '3', '--output', str(run), '--json']
    status, out, err = finish(up(CANADARM, *arguments, *SLOW))
    assert status == 0, err
    summary: dict[str, Any] = json.loads(out)
    rigid, flexible = (
        summary['phases'][f'{name} feedforward']['joint_error']['joint_1']['rms']
        for name in ('rigid', 'flexible')
    )
    # 3 s of eq. 3.56: the rigid model is some 13 mrad off; the flexible one as far as its clock is
    assert flexible < 0.3 * rigid
    deflection = summary['phases']['flexible feedforward']['deflection_error']
    # some 1 % on an idle machine
    assert deflection['link_1/uy']['percent_of_peak'] < 15.0
    assert set(summary['loops']) == {'plant', 'feedforward', 'predictor'}
    page = (run / 'report.html').read_text()
    assert len(page) < 1_500_000
    require_one_look(page, str(run), str(ROOT))
    assert bag_topics(run / 'bag')['/plant/true_deflection'] == 'sensor_msgs/msg/JointState'
    assert b'<flexibility>' in read_attachment(run / 'bag', 'robot_description.urdf')
    assert nodes_below(run) == []
    # a run is never written over
    assert main(['up', CANADARM, '--output', str(run)]) == 1
    err = capsys.readouterr().err
    assert err.count('\n') == 1, err
    assert 'the directory must not exist yet' in err


def test_ctrl_c_ends_all_nodes_and_leaves_a_whole_bag(tmp_path: Path) -> None:
    run = tmp_path / 'run'
    # the phase outlasts what a busy machine takes to show the page
    lasting = ['--duration', '60', '--output', str(run)]
    process = up(CANADARM, *lasting, '--view', *PLANT_ONLY)
    assert process.stderr is not None
    address = ''
    for line in process.stderr:
        if line.startswith('open http'):
            address = line.split()[1]
        if line.startswith('rigid feedforward:'):
            break
    with closing(ViewerClient(address)) as browser:
        assert browser.receive(10.0)  # what the page has to begin with
        wait_for_recording(run)
    process.send_signal(signal.SIGINT)
    status, _, err = finish(process)
    assert status == 130
    assert 'Traceback' not in err
    assert nodes_below(run) == []
    assert '/joint_states' in bag_topics(run / 'bag')
    # what there is is told
    assert json.loads((run / 'summary.json').read_text())['failure'] == 'interrupted'
    assert (
        'ended in phase “rigid feedforward” before its end: interrupted'
        in (run / 'report.html').read_text()
    )


@pytest.mark.parametrize(
    ('setting', 'message'),
    [
        ('nodes.plant.update_rate=fast', "plant: parameter 'update_rate' must be a double"),
        ('nodes.feedforward.modell=rigid', "did you mean 'model'?"),
        ('reference.rate=[1, 2]', 'rate must be a number or 3 numbers'),
        ('beam.link_9.y.ei=1e5', 'beam.link_9.y.ei'),
        ('tip=hand', 'canadarm.yaml: tip must be one of base, link_1, link_2, link_3'),
    ],
)
def test_bad_values_are_refused_before_anything_starts(
    tmp_path: Path, setting: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / 'run'
    assert main(['up', CANADARM, '--output', str(run), '--set', setting]) == 1
    assert message in capsys.readouterr().err
    assert not run.exists()
