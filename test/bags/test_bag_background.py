"""The producer never waits, and every loss is counted."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from frozen_disk import freeze_disk

from denoc_ros.bags.background import BackgroundWriter
from denoc_ros.bags.definitions import encode
from denoc_ros.bags.reader import read_attachment, read_bag, read_raw
from denoc_ros.bags.storage import DiskFile
from denoc_ros.bags.writer import BagWriter
from denoc_ros.errors import BagError

JOINT_STATE = 'sensor_msgs/msg/JointState'
RAW = encode(JOINT_STATE, 1, {'name': ['a'], 'position': [1.0]})


def wait_for(condition: Callable[[], bool], timeout: float = 60.0) -> None:
    """Wait until a condition holds; fail after a bound."""
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.002)


def test_everything_put_is_in_the_bag_in_order(tmp_path: Path) -> None:
    writer = BackgroundWriter(BagWriter(tmp_path / 'run'))
    writer.add_topic('/a', JOINT_STATE)
    writer.attach('robot_description.urdf', '<robot/>')
    for stamp in range(5000):
        assert writer.put('/a', stamp, RAW)
    status = writer.close()
    assert (status.written, status.lost, status.failure) == (5000, {}, '')
    assert [item.log_ns for item in read_bag(tmp_path / 'run')] == list(range(5000))
    assert read_attachment(tmp_path / 'run', 'robot_description.urdf') == b'<robot/>'


def test_message_is_on_disk_within_the_flush_period(tmp_path: Path) -> None:
    writer = BackgroundWriter(BagWriter(tmp_path / 'run.mcap', 'none'), flush_period=0.4)
    writer.add_topic('/a', JOINT_STATE)
    ages = []
    for stamp in range(7):
        start = time.monotonic()
        size = (tmp_path / 'run.mcap').stat().st_size
        writer.put('/a', stamp, RAW)
        wait_for(lambda size=size: (tmp_path / 'run.mcap').stat().st_size > size)  # type: ignore[misc]
        ages.append(time.monotonic() - start)
        time.sleep(0.013)
    writer.close()
    # the median, as a loaded machine may stall the test itself
    assert sorted(ages)[3] < 0.4


def test_split_comes_after_what_was_put_before(tmp_path: Path) -> None:
    writer = BackgroundWriter(BagWriter(tmp_path / 'run'))
    writer.add_topic('/a', JOINT_STATE)
    for stamp in range(30):
        if stamp == 10:
            writer.split()
        writer.put('/a', stamp, RAW)
    writer.close()
    counts = [len(list(read_bag(part))) for part in sorted((tmp_path / 'run').glob('*.mcap'))]
    assert counts == [10, 20]


def test_stalled_disk_delays_nobody_and_losses_are_counted_by_topic(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = BackgroundWriter(BagWriter(tmp_path / 'run'), queue_size=100, flush_period=0.02)
    writer.add_topic('/a', JOINT_STATE)
    writer.add_topic('/b', JOINT_STATE)
    writer.put('/a', 0, RAW)
    wait_for(lambda: writer.status().written == 1)
    released = freeze_disk(monkeypatch)
    writer.put('/a', 1, RAW)
    wait_for(lambda: writer.status().stalled > 0.1)
    start = time.monotonic()
    kept = [writer.put('/b' if stamp % 4 else '/a', stamp, RAW) for stamp in range(2, 1002)]
    assert time.monotonic() - start < 15.0  # one that waited for the disk would take 30 s
    assert sum(kept) == 100
    assert writer.status().lost == {'/a': 225, '/b': 675}
    released.set()
    status = writer.close()
    assert status.written == 102
    assert status.lost == {'/a': 225, '/b': 675}
    assert len(list(read_bag(tmp_path / 'run'))) == 102


@pytest.mark.long_cases('100-1048576')
@pytest.mark.parametrize(('number', 'room'), [(100, 1 << 20), (5000, 20_000)])
def test_messages_put_together_are_kept_and_lost_as_one_by_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, room: int
) -> None:
    batches = [
        [('/b' if stamp % 4 else '/a', 100 * batch + stamp, RAW, None) for stamp in range(90)]
        for batch in range(3)
    ]
    found = []
    for name in ('together', 'one by one'):
        writer = BackgroundWriter(
            BagWriter(tmp_path / name), number, flush_period=1.0, queue_bytes=room
        )
        for topic in ('/a', '/b'):
            writer.add_topic(topic, JOINT_STATE)
        writer.put('/a', 0, RAW)
        wait_for(lambda writer=writer: writer.status().written == 1)  # type: ignore[misc]
        with monkeypatch.context() as patch:
            released = freeze_disk(patch)
            writer.put('/a', 1, RAW)

            def stalled(writer: BackgroundWriter = writer) -> bool:
                """Say whether the writer has taken both and waits for the disk."""
                status = writer.status()
                return status.stalled > 0.5 and status.queued == 0

            wait_for(stalled)
            for batch in batches:
                if name == 'together':
                    writer.put_all(batch)
                else:
                    for message in batch:
                        writer.put(*message)
            released.set()
            status = writer.close()
        kept = [(each.topic, each.log_ns) for each in read_bag(tmp_path / name)]
        found.append((status.written, status.lost, kept))
    assert found[0] == found[1]
    assert found[0][1]


def test_disk_that_never_comes_back_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = BackgroundWriter(BagWriter(tmp_path / 'run'), flush_period=0.02)
    released = freeze_disk(monkeypatch)
    with pytest.raises(BagError, match=r'within 0\.05 s.*denoc recover'):
        writer.close(timeout=0.05)
    released.set()
    writer.close()


def test_recording_ends_whole_before_the_disk_is_short(tmp_path: Path) -> None:
    free = [100 << 20]
    bag = BagWriter(tmp_path / 'run')
    writer = BackgroundWriter(bag, flush_period=0.02, free_space=lambda _: free[0])
    writer.add_topic('/a', JOINT_STATE)
    writer.put('/a', 1, RAW)
    wait_for(lambda: writer.status().written == 1)
    free[0] = 63 << 20
    wait_for(lambda: bool(writer.status().failure))
    assert not writer.put('/a', 2, RAW)
    status = writer.close()
    assert 'must keep 64 MiB free, got 63 MiB' in status.failure
    assert status.lost == {'/a': 1}
    assert len(list(read_bag(tmp_path / 'run'))) == 1


def test_full_disk_loses_what_was_not_flushed_and_counts_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = DiskFile.write
    room = [20_000]

    def short_write(disk: DiskFile, block: bytes) -> int:
        if disk.tell() + len(block) > room[0]:
            write(disk, block[: room[0] - disk.tell()])
            raise OSError(28, 'No space left on device')
        return write(disk, block)

    monkeypatch.setattr(DiskFile, 'write', short_write)
    writer = BackgroundWriter(BagWriter(tmp_path / 'run', 'none'), flush_period=0.01)
    writer.add_topic('/a', JOINT_STATE)
    count = 0
    while not writer.status().failure:
        writer.put('/a', count, RAW)
        count += 1
        time.sleep(0.0005)
        assert count < 20_000
    status = writer.close()
    assert 'got: No space left on device' in status.failure
    assert status.written > 20
    assert status.written + status.lost['/a'] == count
    stamps = [item.log_ns for item in read_bag(tmp_path / 'run')]
    assert stamps == list(range(status.written))


def test_bad_numbers_are_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'run') as bag, pytest.raises(BagError, match='must be > 0'):
        BackgroundWriter(bag, queue_size=0)


def resident_memory() -> int:
    """Return the resident memory of this process [bytes]."""
    pages = int(Path('/proc/self/statm').read_text().split()[1])
    return pages * resource.getpagesize()


def test_memory_behind_a_frozen_disk_is_bounded_in_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bound = 20 << 20
    writer = BackgroundWriter(
        BagWriter(tmp_path / 'run', 'none'), flush_period=0.02, queue_bytes=bound
    )
    writer.add_topic('/large', JOINT_STATE)
    writer.add_topic('/small', JOINT_STATE)
    writer.put('/small', 0, RAW)
    wait_for(lambda: writer.status().written == 1)
    released = freeze_disk(monkeypatch)
    writer.put('/small', 1, RAW)
    wait_for(lambda: writer.status().stalled > 0.1)
    before = resident_memory()
    for stamp in range(3000):
        writer.put('/large', stamp, bytes(100_000))
        assert writer.status().queued_bytes <= bound
    writer.put('/small', 2, RAW)  # still has room
    assert resident_memory() - before < 2 * bound
    released.set()
    status = writer.close()
    kept = len(list(read_raw(tmp_path / 'run', ['/large'])))
    assert bound / 100_200 - 2 <= kept <= bound / 100_200
    assert status.lost == {'/large': 3000 - kept}
    assert status.causes == {'queue_bytes': 3000 - kept}
    assert status.queued_bytes == 0


def test_a_message_larger_than_the_bound_goes_through_an_empty_queue(tmp_path: Path) -> None:
    writer = BackgroundWriter(BagWriter(tmp_path / 'run'), queue_bytes=10)
    writer.add_topic('/a', JOINT_STATE)
    assert writer.put('/a', 0, RAW)
    wait_for(lambda: writer.status().queued_bytes == 0)
    assert writer.put('/a', 1, RAW)
    status = writer.close()
    assert (status.written, status.lost) == (2, {})
