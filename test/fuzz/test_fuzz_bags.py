"""Spoiled recordings: only BagError, no traceback, and memory within bounds."""

from __future__ import annotations

import shutil
from contextlib import suppress
from pathlib import Path

import pytest
from fuzz.mutations import FUZZ, changed_bytes, changed_text
from hypothesis import given
from hypothesis import strategies as st

from denoc_ros.bags.reader import read_attachment, read_bag
from denoc_ros.bags.recover import recover
from denoc_ros.bags.series import read_joint_states
from denoc_ros.bags.writer import BagWriter
from denoc_ros.cli.main import main
from denoc_ros.errors import BagError

JOINT_STATE = 'sensor_msgs/msg/JointState'


@pytest.fixture(scope='module')
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Return small whole bags, one of each compression, the last of several files."""
    made = []
    for name in ('none', 'lz4', 'zstd', 'split'):
        path = tmp_path_factory.mktemp('bags') / name
        size = 4000 if name == 'split' else 0
        with BagWriter(path, 'none' if name == 'split' else name, max_bag_size=size) as writer:
            writer.attach('robot_description.urdf', '<robot/>')
            writer.add_topic('/joint_states', JOINT_STATE)
            for k in range(60):
                writer.write_message(
                    '/joint_states', 1000 * k, name=['a', 'b'], position=[1.0, k], effort=[k, 2.0]
                )
                if k % 20 == 0:
                    writer.flush()
        made.append(path)
    return made


def spoil(folders: list[Path], place: Path, data: st.DataObject) -> Path:
    """Copy a bag and change one of its files; return the copy, or its bare file."""
    copy = place / 'bag'
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(data.draw(st.sampled_from(folders)), copy)
    files = sorted(copy.iterdir())
    file = data.draw(st.sampled_from(files))
    if file.suffix == '.yaml' and data.draw(st.booleans()):
        file.write_text(changed_text(file.read_text(), data))
    else:
        file.write_bytes(changed_bytes(file.read_bytes(), data))
    bare = file.suffix == '.mcap' and data.draw(st.booleans())
    return file if bare else copy


@FUZZ
@given(data=st.data())
def test_a_changed_bag_raises_only_bag_errors(
    folders: list[Path], tmp_path: Path, data: st.DataObject
) -> None:
    path = spoil(folders, tmp_path, data)
    for read in (
        lambda: list(read_bag(path)),
        lambda: read_joint_states(path),
        lambda: read_attachment(path, 'robot_description.urdf'),
        lambda: recover(path, tmp_path / 'recovered'),
    ):
        with suppress(BagError):
            read()  # type: ignore[no-untyped-call]
    shutil.rmtree(tmp_path / 'recovered', ignore_errors=True)


@FUZZ
@given(data=st.data())
def test_recovering_a_changed_bag_shows_no_traceback_and_gives_a_whole_one(
    folders: list[Path], tmp_path: Path, data: st.DataObject, capfd: pytest.CaptureFixture[str]
) -> None:
    path = spoil(folders, tmp_path, data)
    target = tmp_path / 'whole'
    shutil.rmtree(target, ignore_errors=True)
    status = main(['recover', str(path), '-o', str(target)])
    said = capfd.readouterr()
    assert status in (0, 1, 2)
    assert 'Traceback' not in said.err
    assert (status == 1) == (not target.exists())
    if status != 1:
        list(read_bag(target))
