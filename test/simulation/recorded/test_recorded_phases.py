"""Phases of a recorded run: those of its session, else the marks in the bag, else all of it."""

import json
from pathlib import Path
from typing import Any

import pytest

from denoc_ros.bags.reader import bag_contents, read_raw
from denoc_ros.bags.run import RecordedPhase
from denoc_ros.bags.writer import BagWriter
from denoc_ros.errors import BagError
from denoc_ros.simulation.recorded.run_files import recorded_phases


def run_folder(
    folder: Path, marks: list[tuple[int, str]], noted: list[dict[str, Any]] | None
) -> Path:
    """Write a bag with marks of phases, and what a session noted of them."""
    with BagWriter(folder / 'bag') as bag:
        bag.add_topic('/up/phase', 'std_msgs/msg/String')
        for log_ns, name in marks:
            bag.write_message('/up/phase', log_ns, data=name)
    if noted is not None:
        (folder / 'session.json').write_text(json.dumps({'phases': noted}))
    return folder


MARKS = [(10, 'stiff'), (20, ''), (30, 'soft'), (35, 'soft'), (50, '')]


def test_marks_in_the_bag_name_phases_and_a_phase_that_began_anew_counts_once(
    tmp_path: Path,
) -> None:
    found = recorded_phases(run_folder(tmp_path, MARKS, None))
    assert found == (RecordedPhase('stiff', 10, 20), RecordedPhase('soft', 35, 50))


def test_what_the_session_noted_goes_before_the_marks(
    tmp_path: Path,
) -> None:
    noted: list[dict[str, Any]] = [{'name': 'stiff', 'begin_ns': 12, 'end_ns': 18}]
    assert recorded_phases(run_folder(tmp_path, MARKS, noted)) == (RecordedPhase('stiff', 12, 18),)


def test_a_phase_that_did_not_end_says_so_and_lasts_to_the_end_of_the_bag(tmp_path: Path) -> None:
    noted: list[dict[str, Any]] = [{'name': 'stiff', 'begin_ns': 12, 'end_ns': None}]
    assert recorded_phases(run_folder(tmp_path, [], noted)) == (
        RecordedPhase('stiff (unfinished)', 12),
    )


def test_every_reader_takes_the_directory_of_a_session_for_its_bag(tmp_path: Path) -> None:
    run = run_folder(tmp_path, MARKS, [])
    assert bag_contents(run) == bag_contents(run / 'bag')
    assert list(read_raw(run)) == list(read_raw(run / 'bag'))
    with pytest.raises(BagError, match=r'bag folder must hold metadata\.yaml'):
        bag_contents(tmp_path / 'bag' / '..' / '..')


def test_a_recording_without_phases_is_one_without_a_name(tmp_path: Path) -> None:
    assert recorded_phases(run_folder(tmp_path, [], None)) == (RecordedPhase(''),)


def test_phases_are_chosen_by_name_in_the_order_of_the_run(tmp_path: Path) -> None:
    run = run_folder(tmp_path, MARKS, None)
    assert [each.name for each in recorded_phases(run, ('soft', 'stiff'))] == ['stiff', 'soft']
    assert [each.name for each in recorded_phases(run / 'bag', ['soft'])] == ['soft']


def test_a_name_that_no_phase_has_is_refused_with_those_that_there_are(tmp_path: Path) -> None:
    with pytest.raises(BagError, match=r"--phase must be .*'stiff', 'soft'.*got 'hard'"):
        recorded_phases(run_folder(tmp_path, MARKS, None), ['hard'])
