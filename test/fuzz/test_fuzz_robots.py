"""Spoiled robot descriptions: a clear error or a sound model, and never a traceback."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from fuzz.mutations import FUZZ, NUMBER, changed_bytes, changed_text
from hypothesis import given
from hypothesis import strategies as st
from node_robots import gripper, two_links
from suggested_robots import tube_arm

from denoc_ros.cli.main import main
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import DenocError, ModelError
from denoc_ros.model.reading.urdf import load_tree
from denoc_ros.reduction.suggest.suggestion import suggest_flexibility

ROBOTS = sorted((Path(__file__).resolve().parents[2] / 'config' / 'robots').glob('*.urdf'))
PLAIN = [tube_arm(), (ROBOTS[0].parent / 'ur10.urdf').read_text()]
TEXTS = [two_links(), gripper(), *(path.read_text() for path in ROBOTS)]
LARGE = 1e6  # lengths and masses beyond leave the rest of a robot below their rounding
TINY = 1e-15  # of the trace: below it there is rounding only
ROUNDED = 2e-3  # rounded inertias of a file may leave that much below zero, and no more


def require_sound(robot: Robot, text: str) -> None:
    """Hold a model to what it must be: finite, its inertia symmetric and positive semidefinite.

    The last only where the file's numbers are comparable and nothing was warned of.
    """
    sizes = [abs(float(number)) for number in NUMBER.findall(text)]
    comparable = max(sizes, default=0.0) < LARGE and not robot.tree.warnings
    rng = np.random.default_rng(1)
    zero = np.zeros(robot.n)
    for scale in (0.0, 1.0):
        q = np.zeros(robot.n)
        q[robot.joint_indices] = scale * rng.normal(size=len(robot.joint_indices))
        inertia = robot.inertia_matrix(q)
        assert np.isfinite(inertia).all()
        assert np.isfinite(robot.inverse_dynamics(q, zero, zero)).all()
        if robot.n and comparable:
            np.testing.assert_allclose(inertia, inertia.T, rtol=1e-9, atol=1e-9 * inertia.max())
            # a joint may carry no mass at all; else a diagonal of ones, whatever the units
            size = np.sqrt(np.maximum(np.diag(inertia), TINY * np.trace(inertia)))
            scaled = inertia / np.outer(size, size)
            assert np.linalg.eigvalsh(scaled).min() > -ROUNDED


@FUZZ
@given(data=st.data())
def test_a_changed_description_is_refused_or_makes_a_sound_model(data: st.DataObject) -> None:
    text = changed_text(data.draw(st.sampled_from(TEXTS)), data)
    with suppress(ModelError):
        require_sound(load_robot(text if text.lstrip().startswith('<') else f'<{text}'), text)


@FUZZ
@given(data=st.data())
def test_a_changed_plain_robot_gets_sound_beams_or_an_error(data: st.DataObject) -> None:
    text = changed_text(data.draw(st.sampled_from(PLAIN)), data)
    text = text if text.lstrip().startswith('<') else f'<{text}'
    try:
        load_tree(text)
    except ModelError:
        return
    # a file that loads has a proposal, whatever its numbers
    for beam in suggest_flexibility(text).beams:
        assert 0.0 < beam.beam_share <= 1.0
        assert 0.0 < beam.stiffness.ei_range[0] <= beam.stiffness.ei_range[1]


@FUZZ
@given(data=st.data())
def test_a_changed_file_never_shows_a_traceback(
    data: st.DataObject, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    text = data.draw(st.sampled_from(TEXTS))
    if data.draw(st.booleans()):
        content = changed_text(text, data).encode('utf-8', 'surrogatepass')
    else:
        content = changed_bytes(text.encode(), data)
    path = tmp_path / 'robot.urdf'
    path.write_bytes(content)
    status = main(['check', str(path)])
    said = capfd.readouterr()
    assert status in (0, 1, 2)
    assert 'Traceback' not in said.err
    assert (status == 1) == said.err.startswith(f'denoc check: {path}'), said.err
    if status == 1:
        with pytest.raises(DenocError):
            load_robot(path)
