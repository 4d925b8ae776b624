"""Thinned reading keeps some messages, whole, and opens no others."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from denoc_ros.bags import mcap_source
from denoc_ros.bags.joint_state import JOINT_STATE, JointStateMessage
from denoc_ros.bags.reader import read_raw, read_thinned
from denoc_ros.bags.writer import BagWriter
from denoc_ros.errors import BagError

MS = 1_000_000
START = 10**18
TOPICS = ('/a', '/b')


def write_bag(path: Path, compression: str = 'zstd') -> Path:
    """Write two topics, 1 kHz and 100 Hz, for 2 s, in chunks of 0.2 s; /b begins later."""
    encoder = JointStateMessage(['j'], ('position',))
    with BagWriter(path, compression=compression) as bag:
        for topic in (*TOPICS, '/c'):
            bag.add_topic(topic, JOINT_STATE)
        for k in range(2000):
            stamp = START + k * MS
            raw = encoder.encode(stamp, np.array([float(k)]))
            bag.write('/a', stamp, raw)
            bag.write('/c', stamp, raw)
            if k >= 500 and k % 10 == 0:
                bag.write('/b', stamp, raw)
            if k % 200 == 199:
                bag.flush()
    return path


@pytest.mark.parametrize('compression', ['none', 'lz4', 'zstd'])
def test_kept_messages_are_whole_and_evenly_spread(tmp_path: Path, compression: str) -> None:
    path = write_bag(tmp_path / 'run.mcap', compression)
    whole = {(topic, log_ns): raw for topic, _, log_ns, raw in read_raw(path, TOPICS)}
    kept = list(read_thinned(path, TOPICS, 20 * MS))
    assert all(whole[topic, log_ns] == raw for topic, _, log_ns, raw in kept)
    assert {kind for _, kind, _, _ in kept} == {JOINT_STATE}
    stamps = {topic: np.array([row[2] for row in kept if row[0] == topic]) for topic in TOPICS}
    assert [int(stamps[topic][0] - START) for topic in TOPICS] == [0, 500 * MS]
    for topic in TOPICS:
        np.testing.assert_array_equal(np.diff(stamps[topic]), 20 * MS)
    # of a step finer than the messages come, all
    assert len(list(read_thinned(path, ['/b'], MS))) == 150


def test_a_window_is_kept_and_the_first_of_each_topic(tmp_path: Path) -> None:
    path = write_bag(tmp_path / 'run.mcap')
    kept = list(read_thinned(path, TOPICS, 50 * MS, 1000.0 * MS, 1200.0 * MS))
    since = [(topic, (log_ns - START) // MS) for topic, _, log_ns, _ in kept]
    assert [t for topic, t in since if topic == '/a'] == [0, 1000, 1050, 1100, 1150, 1200]
    assert [t for topic, t in since if topic == '/b'] == [500, 1000, 1050, 1100, 1150, 1200]


def test_a_bag_without_an_index_gives_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_bag(tmp_path / 'run.mcap')
    by_index = list(read_thinned(path, TOPICS, 7 * MS, 100.0 * MS, 1500.0 * MS))
    monkeypatch.setattr(mcap_source, '_by_summary', lambda *_: None)
    read_whole = list(read_thinned(path, TOPICS, 7 * MS, 100.0 * MS, 1500.0 * MS))
    assert sorted(by_index) == sorted(read_whole)


def test_the_parts_of_a_folder_are_one_bag(tmp_path: Path) -> None:
    encoder = JointStateMessage(['j'], ('position',))
    with BagWriter(tmp_path / 'bag', max_bag_size=20_000) as bag:
        bag.add_topic('/a', JOINT_STATE)
        for k in range(3000):
            stamp = START + k * MS
            bag.write('/a', stamp, encoder.encode(stamp, np.random.default_rng(k).normal(size=1)))
            if k % 100 == 99:
                bag.flush()
    assert len(list((tmp_path / 'bag').glob('*.mcap'))) > 2
    times = [log_ns for _, _, log_ns, _ in read_thinned(tmp_path / 'bag', ['/a'], 10 * MS)]
    np.testing.assert_array_equal(np.diff(times), 10 * MS)
    assert len(times) == 300


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_a_changed_bag_raises_nothing_but_bag_errors(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = write_bag_once(tmp_path_factory)
    spoiled = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 8))):
        # the second half holds the last chunks' indexes and the summary
        place = data.draw(st.integers(len(spoiled) // 2, len(spoiled) - 9))
        spoiled[place] = data.draw(st.integers(0, 255))
    file = path.with_name('spoiled.mcap')
    file.write_bytes(spoiled)
    with contextlib.suppress(BagError):
        list(read_thinned(file, TOPICS, 20 * MS))


_made: list[Path] = []


def write_bag_once(factory: pytest.TempPathFactory) -> Path:
    if not _made:
        _made.append(write_bag(factory.mktemp('spoiled') / 'run.mcap', 'none'))
    return _made[0]
