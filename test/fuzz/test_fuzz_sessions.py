"""A changed session.json: numbers and a page, or findings; never a traceback."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fuzz.mutations import FUZZ
from hypothesis import given
from hypothesis import strategies as st
from planar_chains import FLEXIBLE, RIGID, planar_chain

from denoc_ros.bags.writer import BagWriter
from denoc_ros.cli.main import main

BEGIN_NS = 1_700_000_000_000_000_000
SESSION: dict[str, Any] = {
    'kind': 'up',
    'name': 'arm',
    'robot': '/robots/arm.urdf',
    'gravity': [0.0, -9.81, 0.0],
    'tip': '',
    'command': 'denoc up arm.yaml',
    'time': {'mode': 'simulated', 'why': 'as asked for', 'begun_ns': BEGIN_NS, 'factor': 2.0},
    'versions': {'python': '3.12', 'system': 'Linux', 'processors': '2'},
    'model': {'joint.joint_1.damping': 0.5, 'beam.link_1.shape': 'clamped-free'},
    'plant': {'joint.joint_1.damping': 0.25},
    'beams': 'plant: 1 mode',
    'failure': 'interrupted',
    'geometric_stiffness': True,
    'phases': [
        {'name': 'one', 'begin_ns': BEGIN_NS, 'end_ns': BEGIN_NS + 10**8, 'wall': 0.1},
        {'name': 'two', 'begin_ns': BEGIN_NS + 10**8, 'end_ns': None},
    ],
}
STRANGE = st.sampled_from(
    [None, True, 1, -1, 0.5, 1e300, 10**400, '', 'z', '\ud800', [], [1], ['z'], {}, {'name': 1}]
    + [float('nan'), float('inf'), 'simulate', [[]], [{}], [None], {'z': [1.0]}, '../..', '\x00']
)


def places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Yield every mapping or list inside a value, each with its keys in turn."""
    keys = list(value) if isinstance(value, dict) else list(range(len(value)))
    for key in keys:
        yield value, key
        if isinstance(value[key], (dict, list)):
            yield from places(value[key])


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the directory of a short run of an arm, whose pictures no session changes."""
    monkeypatch.setattr('denoc_ros.reports.run_page.moments', lambda *_: None)

    with BagWriter(tmp_path / 'bag') as bag:
        bag.attach('robot_description.urdf', planar_chain([FLEXIBLE, RIGID]))
        bag.add_topic('/joint_states', 'sensor_msgs/msg/JointState')
        for k in range(20):
            stamp_ns, position = BEGIN_NS + k * 10**7, [0.1 * k, 0.2]
            bag.write_message(
                '/joint_states', stamp_ns, name=['joint_1', 'joint_2'], position=position
            )
    return tmp_path


@FUZZ
@given(data=st.data())
def test_a_changed_session_gives_a_page_or_findings(
    run: Path, data: st.DataObject, capfd: pytest.CaptureFixture[str]
) -> None:
    session = json.loads(json.dumps(SESSION))
    for _ in range(data.draw(st.integers(1, 3))):
        inside, key = data.draw(st.sampled_from(list(places(session))))
        if data.draw(st.booleans()):
            inside[key] = copy.deepcopy(data.draw(STRANGE))
        else:
            del inside[key]
    (run / 'session.json').write_text(json.dumps(session))
    status = main(['report', str(run), '-o', str(run / 'page.html'), '--json'])
    said = capfd.readouterr()
    assert 'Traceback' not in said.err
    assert status in (0, 1)
    assert (status == 1) == (not said.out)


def test_a_session_as_it_is_written_gives_a_page(run: Path) -> None:
    (run / 'session.json').write_text(json.dumps(SESSION))
    assert main(['report', str(run), '-o', str(run / 'page.html')]) == 0
