"""Each optional part can be removed: its verbs, nodes and parameters go, the rest works."""

from __future__ import annotations

from pathlib import Path

import pytest
from needed_parts import missing_parts, needed_parts
from trust.removed_parts import attempt

from denoc_ros.errors import ConfigError
from denoc_ros.parts import PARTS, added_rows, nodes, optional, parts, required


@pytest.mark.long_cases('feedback', 'reduction', 'viewer', 'export')
@pytest.mark.parametrize('part', PARTS)
def test_what_is_left_without_a_part_is_whole(part: str) -> None:
    if not missing_parts():  # A copy that lacks a part is no checkout.
        assert attempt(part, quick=True) == ''


def test_module_of_a_part_that_is_not_there_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    known = {name: each for name, each in parts().items() if name != 'feedback'}
    monkeypatch.setattr('denoc_ros.parts.parts', lambda: known)
    assert optional('feedback.live_feedback') is None
    assert list(added_rows('feedforward')) == []
    with pytest.raises(ConfigError, match="its part 'feedback'"):
        required('feedback.live_feedback', 'feedforward')


def test_parts_add_nodes_to_those_of_the_core() -> None:
    core = {'feedforward', 'predictor', 'recorder', 'plant'}
    assert core <= nodes().keys()
    added = {name for part in parts().values() for name in part.nodes}
    assert nodes().keys() == core | added


@pytest.mark.parts('feedback')
def test_needs_of_a_test_are_those_of_what_it_imports(repository: Path) -> None:
    assert needed_parts(repository / 'test/test_units.py') == set()
    assert 'feedback' in needed_parts(repository / 'test/feedback/test_strain_damping.py')
