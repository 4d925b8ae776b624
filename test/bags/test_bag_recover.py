"""After a kill, all but the last flush period is there."""

from __future__ import annotations

import errno
import io
import itertools
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from child_processes import child
from mcap.reader import make_reader

from denoc_ros.bags.reader import read_attachment, read_bag
from denoc_ros.bags.recover import recover
from denoc_ros.bags.storage import CompleteRecords
from denoc_ros.bags.writer import BagWriter
from denoc_ros.cli.main import main
from denoc_ros.errors import BagError

JOINT_STATE = 'sensor_msgs/msg/JointState'
FLUSH_PERIOD = 0.2

WRITE_FOREVER = """
import sys, time
from denoc_ros.bags.background import BackgroundWriter
from denoc_ros.bags.definitions import encode
from denoc_ros.bags.writer import BagWriter
writer = BackgroundWriter(BagWriter(sys.argv[1]), flush_period=float(sys.argv[2]))
writer.add_topic('/joint_states', 'sensor_msgs/msg/JointState')
writer.attach('robot_description.urdf', '<robot/>')
raw = encode('sensor_msgs/msg/JointState', 1, {'name': ['a'], 'position': [1.0]})
while True:
    now = time.time_ns()
    writer.put('/joint_states', now, raw)
    print(now, flush=True)
    time.sleep(0.001)
"""


def cut_off_bag(folder: Path, count: int = 300, split: int = 0) -> Path:
    """Return a bag as a kill leaves it, its last record torn."""
    writer = BagWriter(folder / 'run')
    writer.attach('robot_description.urdf', '<robot/>')
    writer.add_topic('/joint_states', JOINT_STATE)
    for index in range(count):
        if index and split and index % split == 0:
            writer.split()
        writer.write_message('/joint_states', index + 1, name=['a'], position=[index])
        if index % 100 == 99:
            writer.flush()
    last = max((folder / 'run').glob('*.mcap'), key=lambda path: int(path.stem.split('_')[-1]))
    with last.open('ab') as stream:
        stream.write(b'\x06\xff\x03\x00\x00\x00\x00\x00\x00torn')
    return folder / 'run'


def test_killed_process_loses_at_most_the_flush_period(tmp_path: Path) -> None:
    script = [sys.executable, '-c', WRITE_FOREVER, str(tmp_path / 'run'), str(FLUSH_PERIOD)]
    with child(script, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        first = int(process.stdout.readline())
        time.sleep(1.53)
        process.send_signal(signal.SIGKILL)
        killed = time.time_ns()
        put = [first, *(int(line) for line in process.stdout.read().split())]
    result = recover(tmp_path / 'run')
    kept = [item.log_ns for item in read_bag(result.path)]
    assert kept == put[: len(kept)]
    assert len(kept) > 50  # several flushes; a busy machine writes less than it might
    # the thread that flushes may wait for a processor as long as the one that puts
    longest_wait = max(b - a for a, b in itertools.pairwise(put))
    due = [stamp for stamp in put if stamp < killed - FLUSH_PERIOD * 1e9 - 2 * longest_wait]
    assert len(kept) >= len(due)
    assert result.torn == ('run_0.mcap',)
    assert read_attachment(result.path, 'robot_description.urdf') == b'<robot/>'


def test_original_stays_as_it_is_and_times_are_kept(tmp_path: Path) -> None:
    run = cut_off_bag(tmp_path)
    before = {path: path.read_bytes() for path in run.iterdir()}
    result = recover(run)
    assert {path: path.read_bytes() for path in run.iterdir()} == before
    assert result.path == tmp_path / 'run_recovered'
    assert result.counts == {'/joint_states': 300}
    assert [item.log_ns for item in read_bag(result.path)] == list(range(1, 301))
    with (result.path / 'run_0.mcap').open('rb') as stream:
        rows = list(make_reader(stream, validate_crcs=True).iter_messages())
    assert [message.sequence for _, _, message in rows] == list(range(300))


def test_recovering_again_changes_nothing_and_never_overwrites(tmp_path: Path) -> None:
    run = cut_off_bag(tmp_path)
    first = recover(run)
    before = {path.name: path.read_bytes() for path in first.path.iterdir()}
    assert recover(run) == first
    assert {path.name: path.read_bytes() for path in first.path.iterdir()} == before
    of_whole = recover(first.path)
    assert of_whole.torn == ()
    assert of_whole.messages == 300
    (first.path / 'metadata.yaml').write_text('somebody else')
    with pytest.raises(BagError, match='must not exist yet'):
        recover(run)
    assert (first.path / 'metadata.yaml').read_text() == 'somebody else'
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        'run',
        'run_recovered',
        'run_recovered_recovered',
    ]


def test_split_bag_is_recovered_file_by_file_in_order(tmp_path: Path) -> None:
    run = cut_off_bag(tmp_path, count=1100, split=100)
    result = recover(run)
    assert [part.name for part in result.files] == [f'run_{k}.mcap' for k in range(11)]
    assert result.torn == ('run_10.mcap',)
    assert [item.log_ns for item in read_bag(result.path)] == list(range(1, 1101))


@pytest.mark.parametrize('size', range(8))
def test_a_file_torn_in_its_first_bytes_spoils_no_other(tmp_path: Path, size: int) -> None:
    run = cut_off_bag(tmp_path, count=300, split=100)
    os.truncate(run / 'run_1.mcap', size)
    result = recover(run)
    assert result.torn == ('run_1.mcap', 'run_2.mcap')
    assert result.left_out == ()
    assert [item.log_ns for item in read_bag(result.path)] == [*range(1, 101), *range(201, 301)]


def test_records_behind_a_damaged_first_byte_are_recovered(tmp_path: Path) -> None:
    run = cut_off_bag(tmp_path, count=300, split=100)
    content = (run / 'run_1.mcap').read_bytes()
    (run / 'run_1.mcap').write_bytes(b'\x00' + content[1:])
    result = recover(run)
    assert result.torn == ('run_1.mcap', 'run_2.mcap')
    assert [item.log_ns for item in read_bag(result.path)] == list(range(1, 301))


def test_a_file_that_is_no_mcap_is_left_out_and_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = cut_off_bag(tmp_path, count=300, split=100)
    (run / 'run_1.mcap').write_text('hello')
    assert main(['recover', str(run)]) == 2
    assert 'run_1.mcap was left out: it is no MCAP file' in capsys.readouterr().out
    kept = [item.log_ns for item in read_bag(tmp_path / 'run_recovered')]
    assert kept == [*range(1, 101), *range(201, 301)]


@pytest.mark.parametrize('name', ['metadata.yaml', 'run_0.mcap', 'run_1.mcap'])
@pytest.mark.parametrize('size', [0, 5])
def test_a_torn_file_of_a_bag_leads_to_its_recovery(tmp_path: Path, name: str, size: int) -> None:
    with BagWriter(tmp_path / 'run') as writer:
        writer.add_topic('/joint_states', JOINT_STATE)
        writer.split()
        writer.write_message('/joint_states', 1, name=['a'], position=[0.0])
    os.truncate(tmp_path / 'run' / name, size)
    with pytest.raises(BagError, match='run: denoc recover'):
        list(read_bag(tmp_path / 'run'))
    recovered = recover(tmp_path / 'run')
    assert len(list(read_bag(recovered.path))) == (name != 'run_1.mcap')


def test_single_file_becomes_a_single_file_on_request(tmp_path: Path) -> None:
    run = cut_off_bag(tmp_path)
    result = recover(run / 'run_0.mcap', tmp_path / 'whole.mcap')
    assert len(list(read_bag(tmp_path / 'whole.mcap'))) == result.messages == 300
    assert result.files[0].name == 'whole.mcap'
    assert recover(run / 'run_0.mcap').path == run / 'run_0_recovered'


@pytest.mark.parametrize('share', [0.0, 0.01, 0.3, 0.7, 0.999])
def test_file_cut_anywhere_keeps_its_complete_records(tmp_path: Path, share: float) -> None:
    content = (cut_off_bag(tmp_path) / 'run_0.mcap').read_bytes()
    path = tmp_path / 'cut.mcap'
    path.write_bytes(content[: 8 + int(share * (len(content) - 8))])
    result = recover(path)
    kept = [item.log_ns for item in read_bag(result.path)]
    assert kept == list(range(1, len(kept) + 1))
    assert len(kept) % 100 == 0


def test_damaged_chunk_is_left_out_and_reported(tmp_path: Path) -> None:
    path = cut_off_bag(tmp_path) / 'run_0.mcap'
    content = bytearray(path.read_bytes())
    middle = [match.start() for match in re.finditer(b'zstd', content)][1]
    content[middle + 40] ^= 0xFF
    (tmp_path / 'damaged.mcap').write_bytes(content)
    result = recover(tmp_path / 'damaged.mcap')
    assert result.damaged_chunks == 1
    kept = [item.log_ns for item in read_bag(result.path)]
    assert kept == [*range(1, 101), *range(201, 301)]


def test_what_is_no_mcap_is_refused(tmp_path: Path) -> None:
    (tmp_path / 'text.mcap').write_text('hello')
    with pytest.raises(BagError, match='must be an MCAP file'):
        recover(tmp_path / 'text.mcap')
    (tmp_path / 'text.mcap').write_text('')
    with pytest.raises(BagError, match='must be an MCAP file, got an empty one'):
        recover(tmp_path / 'text.mcap')
    with pytest.raises(BagError, match=r'must be a \.mcap file or a folder'):
        recover(tmp_path / 'nothing.mcap')
    run = cut_off_bag(tmp_path, count=200, split=100)
    with pytest.raises(BagError, match='must be a folder'):
        recover(run, tmp_path / 'one.mcap')
    assert sorted(path.name for path in tmp_path.iterdir()) == ['run', 'text.mcap']


def test_unwritable_output_is_a_clear_error(tmp_path: Path) -> None:
    run = cut_off_bag(tmp_path, count=1)
    (tmp_path / 'file').write_text('')
    with pytest.raises(BagError, match='must be able to write'):
        recover(run, tmp_path / 'file' / 'out')


def test_verb_prints_what_it_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = cut_off_bag(tmp_path)
    assert main(['recover', str(run)]) == 0
    shown = capsys.readouterr().out
    assert '300 messages in 1 file' in shown
    assert 'run_0.mcap was cut off' in shown
    assert main(['recover', str(run), '--json', '-o', str(tmp_path / 'x')]) == 0
    row = json.loads(capsys.readouterr().out)
    assert row['topics'] == {'/joint_states': 300}
    assert row['path'] == os.fspath(tmp_path / 'x')


def test_a_damaged_profile_does_not_spoil_what_is_recovered(tmp_path: Path) -> None:
    path = cut_off_bag(tmp_path)
    file = path / 'run_0.mcap'
    file.write_bytes(file.read_bytes().replace(b'ros2', b'ro\x00s', 1))
    result = recover(path)
    assert len(list(read_bag(result.path))) == 300


class FailingDisk(io.BytesIO):
    """A file of which the disk gives the first bytes only."""

    def read(self, size: int | None = -1, /) -> bytes:
        """Return bytes, or raise what a disk raises."""
        if self.tell() > 60:
            raise OSError(errno.EIO, 'Input/output error')
        return super().read(size)


def test_an_error_of_the_disk_is_no_torn_record(tmp_path: Path) -> None:
    whole = next(cut_off_bag(tmp_path).glob('*.mcap')).read_bytes()
    with pytest.raises(OSError, match='Input/output error'):
        list(CompleteRecords(FailingDisk(whole)))


def test_damaged_bytes_end_a_file_and_raise_nothing(tmp_path: Path) -> None:
    whole = next(cut_off_bag(tmp_path, count=20).glob('*.mcap')).read_bytes()
    random = np.random.default_rng(0)
    for _ in range(1000):
        damaged = np.frombuffer(whole, np.uint8).copy()
        at = random.integers(len(whole), size=random.integers(1, 12))
        damaged[at] = random.choice(np.array([0, 0x7F, 0xFF, random.integers(256)]), size=len(at))
        list(CompleteRecords(io.BytesIO(damaged.tobytes())))
