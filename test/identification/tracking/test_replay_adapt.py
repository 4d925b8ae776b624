"""Numbers tracked along a bag: found as in the run itself, and said in table, JSON and page."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated_bags import SimulatedBag
from tracked_bags import is_as_heard, write_tracked
from tracked_runs import TrackedRun, follow, simulated, swinging, with_noise

import denoc_ros as dn
from denoc_ros.cli.main import main
from denoc_ros.identification.tracking.tracked_recording import AdaptSettings
from denoc_ros.simulation.recorded.replay_settings import ReplaySettings

ROBOT = Path(__file__).resolve().parents[3] / 'config' / 'robots' / 'canadarm_gauges.urdf'
TOOL = 'payload.tool.mass'
KNOWN, TRUE = 100.0, 120.0
PERIOD = 0.005


def arm(mass: float = KNOWN) -> dn.Robot:
    robot = dn.load_robot(ROBOT, gravity=(0.0, 0.0, 0.0))
    return robot.with_overrides({TOOL: mass})


@cache
def swing() -> TrackedRun:
    return with_noise(simulated(arm(TRUE), swinging(3), 3.0, PERIOD))


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tracked(swing(), arm(), tmp_path_factory.mktemp('bags') / 'run.mcap')


def test_a_payload_of_a_fifth_more_is_found_as_by_who_hears_the_run(bag: Path) -> None:
    found = dn.replay_bag(bag, arm(), adapt=AdaptSettings((TOOL,))).adapted
    assert found is not None
    assert found.paths == (TOOL,)
    assert abs(found.last[0] - TRUE) < 0.02 * TRUE  # 0.1 to 0.7 % after 2 s with four seeds
    assert found.supported.all()
    assert not found.cause
    assert found.start == KNOWN
    assert np.all((found.values >= 50.0) & (found.values <= 150.0))
    assert found.values.shape == found.deviations.shape == (len(found.t), 1)
    assert 0.0 < found.deviations[-1, 0] < found.deviations[0, 0]
    tracker = dn.ParameterTracker(arm(), [TOOL])
    heard = follow(tracker, swing(), sensors=True)[:, 0]
    assert is_as_heard(found, swing(), heard)


def test_effort_of_a_topic_of_its_own_counts(tmp_path: Path) -> None:
    path = write_tracked(swing(), arm(), tmp_path / 'run.mcap', '/drives/effort')
    settings = ReplaySettings(effort='/drives/effort')
    found = dn.replay_bag(path, arm(), settings=settings, adapt=AdaptSettings((TOOL,))).adapted
    assert found is not None
    assert abs(found.last[0] - TRUE) < 0.02 * TRUE


def test_nothing_is_tracked_unless_it_is_asked_for(bag: Path) -> None:
    assert dn.replay_bag(bag, arm()).adapted is None
    assert dn.replay_bag(bag, arm(), adapt=AdaptSettings()).adapted is None


def test_joints_alone_say_nothing(simulated_bag: SimulatedBag) -> None:
    robot = simulated_bag.robot.with_overrides({'payload.tool.mass': 1.0})
    # no effort of that name: a topic that is there, with names of no joint
    settings = ReplaySettings(effort='/plant/true_deflection')
    found = dn.replay_bag(
        simulated_bag.path, robot, settings=settings, adapt=AdaptSettings((TOOL,))
    ).adapted
    assert found is not None
    assert np.all(found.values == 1.0)
    assert not found.supported.any()
    assert found.cause == 'no effort and no values of sensors'


def replayed(capsys: pytest.CaptureFixture[str], bag: Path, *more: str) -> tuple[int, Any, str]:
    page = bag.with_suffix('.html')
    command = ['replay', str(bag), '--robot', str(ROBOT), '--gravity', '0', '0', '0']
    command += ['--payload', f'tool={KNOWN:g}', '--no-output', '--report', str(page), *more]
    status = main(command)
    return status, capsys.readouterr(), page.read_text() if page.exists() else ''


@pytest.mark.parts('reports')
def test_table_json_and_page_say_the_number_over_time(
    bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ['--adapt', 'payload.tool', '--adapt-bounds', f'{TOOL}=50:200', '--adapt-memory', '1']
    status, said, page = replayed(capsys, bag, *asked, '--json')
    assert status == 0
    adapted = json.loads(said.out)['adapted']
    number = adapted['numbers'][TOOL]
    assert number['bounds'] == [50.0, 200.0]
    assert number['start'] == KNOWN
    assert number['value'] == number['values'][-1] == pytest.approx(TRUE, rel=0.02)
    assert number['half_interval'] == number['half_intervals'][-1]
    assert len(adapted['time_s']) == len(number['values']) == len(number['half_intervals'])
    assert np.all(np.diff(adapted['time_s']) > 0.0)
    assert '<h2>Tracked numbers' in page
    assert TOOL in page
    status, said, _ = replayed(capsys, bag, *asked)
    assert status == 0
    assert 'tracked numbers, SI units (95 %)' in said.out
    (line,) = (line for line in said.out.splitlines() if line.strip().startswith(TOOL))
    assert 'yes' in line


@pytest.mark.parametrize(
    ('more', 'says'),
    [
        (['--adapt', 'payload.nothing'], "'payload.nothing' must be of one of payload."),
        (['--adapt', TOOL, '--adapt-bounds', f'{TOOL}=120:200'], 'must have its value 100 within'),
        (['--adapt', TOOL, '--adapt-bounds', 'x'], '--adapt-bounds must be PATH=LOW:HIGH'),
        (['--adapt-memory', '1'], '--adapt must name what is tracked'),
        (['--adapt', TOOL, '--adapt-memory', '-1'], 'memory must be > 0'),
    ],
)
def test_what_cannot_be_tracked_is_one_line(
    bag: Path, capsys: pytest.CaptureFixture[str], more: list[str], says: str
) -> None:
    status, said, _ = replayed(capsys, bag, *more)
    assert status == 1
    assert says in said.err
