"""What is deleted, moved, replaced or cut while it is written is noticed; the bag goes on."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from denoc_ros.bags.background import BackgroundWriter, WriterStatus
from denoc_ros.bags.definitions import encode
from denoc_ros.bags.reader import read_attachment, read_bag
from denoc_ros.bags.writer import BagWriter

FLOAT = 'std_msgs/msg/Float64'
RAW = encode(FLOAT, 0, {'data': 1.0})
NOTICE = 1.0  # s


def begin(path: Path) -> BagWriter:
    """Return a bag with three messages on the disk."""
    writer = BagWriter(path, 'none')
    writer.add_topic('/a', FLOAT)
    writer.attach('robot_description.urdf', '<robot/>')
    write(writer, 1, 2, 3)
    return writer


def write(writer: BagWriter, *stamps: int) -> None:
    for stamp in stamps:
        writer.write('/a', stamp, RAW)
    writer.flush()


def stamps(path: Path) -> list[int]:
    return [item.log_ns for item in read_bag(path)]


def named(folder: Path) -> list[str]:
    """Return the files that metadata.yaml names; each must exist."""
    text = (folder / 'metadata.yaml').read_text()
    names = yaml.safe_load(text)['rosbag2_bagfile_information']['relative_file_paths']
    assert all((folder / name).exists() for name in names)
    return [str(name) for name in names]


def delete(file: Path) -> None:
    file.unlink()


def rename(file: Path) -> None:
    file.rename(file.with_name('elsewhere.mcap'))


def substitute(file: Path) -> None:
    other = file.with_name('other')
    other.write_bytes(b'another file')
    other.replace(file)


def cut(file: Path) -> None:
    os.truncate(file, 100)


def cut_and_written_on(file: Path) -> None:
    file.write_bytes(bytes(100_000))


@pytest.mark.parametrize(
    ('spoil', 'cause'),
    [
        (delete, 'a deleted one'),
        (rename, 'a moved or renamed one'),
        (substitute, 'one replaced by another'),
        (cut, 'one of 100 bytes instead of'),
        (cut_and_written_on, 'one of 100000 bytes instead of'),
    ],
)
def test_bag_goes_on_in_a_file_beside_one_that_is_spoiled(
    tmp_path: Path, spoil: Callable[[Path], None], cause: str
) -> None:
    writer = begin(tmp_path / 'run')
    assert not writer.check()
    spoil(tmp_path / 'run' / 'run_0.mcap')
    left = {file: file.read_bytes() for file in (tmp_path / 'run').iterdir()}
    assert writer.check()
    write(writer, 4, 5)
    assert not writer.check()
    writer.close()
    (loss,) = writer.losses
    assert cause in str(loss)
    assert '; 3 messages, ' in str(loss)
    assert str(loss).endswith(f'goes on in {tmp_path / "run" / "run_1.mcap"}')
    assert named(tmp_path / 'run') == ['run_1.mcap']
    assert stamps(tmp_path / 'run') == [4, 5]
    assert read_attachment(tmp_path / 'run', 'robot_description.urdf') == b'<robot/>'
    # nothing of anybody else's is touched; what was only moved is finished
    for file, content in left.items():
        assert file.read_bytes()[: len(content)] == content
        if spoil is rename:
            assert stamps(file) == [1, 2, 3]
        else:
            assert file.stat().st_size == len(content)


def test_bag_goes_on_in_a_new_folder_when_its_folder_is_deleted(tmp_path: Path) -> None:
    writer = begin(tmp_path / 'run')
    writer.split()
    write(writer, 4)
    shutil.rmtree(tmp_path / 'run')
    assert writer.check()
    write(writer, 5)
    writer.close()
    assert [loss.contents.messages for loss in writer.losses] == [3, 1]
    assert writer.path.parent == tmp_path
    assert writer.path.name.startswith('run_2')
    assert list(tmp_path.iterdir()) == [writer.path]
    assert named(writer.path) == [f'{writer.path.name}_0.mcap']
    assert stamps(writer.path) == [5]


def test_nothing_of_another_folder_in_its_place_is_touched(tmp_path: Path) -> None:
    writer = begin(tmp_path / 'run')
    for moved in ('moved_1', 'moved_2'):
        writer.path.rename(tmp_path / moved)
        writer.path.mkdir()
        foreign = writer.path
        (foreign / 'mine').write_text('mine')
        assert writer.check()
        assert [file.name for file in foreign.iterdir()] == ['mine']
        write(writer, 4)
    writer.close()
    assert stamps(tmp_path / 'moved_1' / 'run_0.mcap') == [1, 2, 3]
    assert stamps(writer.path) == [4]
    assert len(list(tmp_path.glob('run*'))) == 3


def test_bare_file_goes_on_beside_itself(tmp_path: Path) -> None:
    writer = begin(tmp_path / 'deep' / 'run.mcap')
    shutil.rmtree(tmp_path / 'deep')
    assert writer.check()
    write(writer, 4)
    writer.close()
    assert writer.path.match('deep/run_2*.mcap')
    assert stamps(writer.path) == [4]


def test_number_that_somebody_took_is_left_alone(tmp_path: Path) -> None:
    writer = begin(tmp_path / 'run')
    (tmp_path / 'run' / 'run_1.mcap').write_text('mine')
    (tmp_path / 'run' / 'run_0.mcap').unlink()
    writer.check()
    write(writer, 4)
    writer.close()
    assert named(tmp_path / 'run') == ['run_2.mcap']
    assert (tmp_path / 'run' / 'run_1.mcap').read_text() == 'mine'


def test_end_names_what_exists(tmp_path: Path) -> None:
    writer = begin(tmp_path / 'run')
    for stamp in (4, 5):
        writer.split()
        write(writer, stamp)
    (tmp_path / 'run' / 'run_1.mcap').unlink()
    (tmp_path / 'run' / 'run_2.mcap').unlink()
    writer.close()
    assert named(tmp_path / 'run') == ['run_0.mcap']
    assert stamps(tmp_path / 'run') == [1, 2, 3]
    assert sorted(loss.path.name for loss in writer.losses) == ['run_1.mcap', 'run_2.mcap']


@pytest.mark.parametrize(
    ('spoil', 'cause'),
    [
        (delete, 'a deleted or moved one'),
        (cut, 'one of 100 bytes instead of'),
        (cut_and_written_on, 'one of 100000 bytes instead of'),
    ],
)
def test_finished_file_that_is_spoiled_is_noticed(
    tmp_path: Path, spoil: Callable[[Path], None], cause: str
) -> None:
    with begin(tmp_path / 'run') as writer:
        writer.split()
        write(writer, 4)
        assert not writer.check()
        assert not writer.losses
        spoil(tmp_path / 'run' / 'run_0.mcap')
        assert not writer.check()
        (loss,) = writer.losses
        assert cause in str(loss)
        assert str(loss).endswith('are lost')
        assert loss.contents.messages == 3
    assert named(tmp_path / 'run') == ['run_1.mcap']
    assert len(writer.losses) == 1


def wait_for(writer: BackgroundWriter, condition: Callable[[WriterStatus], bool]) -> float:
    """Wait until a condition holds of the status; return how long that took [s]."""
    begin = time.monotonic()
    while not condition(writer.status()):
        assert time.monotonic() < begin + 60.0
        time.sleep(0.005)
    return time.monotonic() - begin


@pytest.mark.parametrize('flush_period', [0.05, 60.0])
def test_background_writer_notices_within_a_second(tmp_path: Path, flush_period: float) -> None:
    writer = BackgroundWriter(BagWriter(tmp_path / 'run'), flush_period=flush_period)
    writer.add_topic('/a', FLOAT)
    for stamp in range(5):
        writer.put('/a', stamp, RAW)
    wait_for(writer, lambda now: now.written == 5)
    (tmp_path / 'run' / 'run_0.mcap').unlink()
    assert wait_for(writer, lambda now: bool(now.losses)) < NOTICE
    now = writer.status()
    assert (now.written, now.lost, now.causes) == (0, {'/a': 5}, {'file': 5})
    writer.put('/a', 7, RAW)
    now = writer.close()
    assert (now.written, now.lost, now.failure) == (1, {'/a': 5}, '')
    assert stamps(tmp_path / 'run') == [7]


def test_refusal_to_begin_anew_ends_the_recording_with_its_cause(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = BackgroundWriter(BagWriter(tmp_path / 'run'), flush_period=0.05)
    writer.add_topic('/a', FLOAT)
    writer.put('/a', 1, RAW)
    wait_for(writer, lambda now: now.written == 1)

    def refuse(_: BagWriter) -> None:
        raise OSError(30, 'Read-only file system')

    monkeypatch.setattr(BagWriter, '_file_beside', refuse)
    (tmp_path / 'run' / 'run_0.mcap').unlink()
    wait_for(writer, lambda now: bool(now.failure))
    writer.put('/a', 2, RAW)
    now = writer.close()
    assert 'Read-only file system' in now.failure
    assert (now.lost, now.causes) == ({'/a': 2}, {'file': 1, 'disk': 1})
