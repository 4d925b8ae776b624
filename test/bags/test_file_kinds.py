"""Files that are no recordings: named, with what to do with them."""

from __future__ import annotations

import io
import wave
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from denoc_ros.bags.reader import bag_topics
from denoc_ros.cli.main import main
from denoc_ros.cli.verbs import verbs
from denoc_ros.errors import BagError


def sound() -> bytes:
    stream = io.BytesIO()
    with wave.open(stream, 'wb') as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(8000)
        file.writeframes(bytes(1000))
    return stream.getvalue()


def arrays() -> bytes:
    stream = io.BytesIO()
    np.savez(stream, t=np.arange(20.0), y=np.arange(20.0))
    return stream.getvalue()


def archive(*names: str) -> Callable[[], bytes]:
    def made() -> bytes:
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, 'w') as file:
            for name in names:
                file.writestr(name, 'x')
        return stream.getvalue()

    return made


KINDS: dict[str, tuple[Callable[[], bytes], str, str]] = {
    'run.bag': (lambda: b'#ROSBAG V2.0\n' + bytes(100), 'a bag of ROS 1', 'rosbags-convert'),
    'tap.wav': (sound, 'a sound file', '--rate'),
    'flight.ulg': (lambda: b'ULog\x01\x12\x35\x01' + bytes(100), 'a ULog file', 'ulog2csv'),
    'run.npz': (arrays, 'arrays of NumPy', 'save them as .csv'),
    'run.npy': (lambda: b'\x93NUMPY\x01' + bytes(100), 'an array of NumPy', 'save it as .csv'),
    'run.ods': (archive('mimetype', 'content.xml'), 'OpenDocument', 'save it as .xlsx'),
    'run.zip': (archive('a.csv'), 'a zip archive', 'unpack it'),
    'run.xls': (lambda: b'\xd0\xcf\x11\xe0' + bytes(100), 'spreadsheet', 'save it as .csv'),
    'run.csv.zst': (lambda: b'\x28\xb5\x2f\xfd' + bytes(100), 'compressed by zstd', 'zstd -d'),
    'run.csv.gz': (lambda: b'\x1f\x8b' + bytes(100), 'a compressed file', 'gunzip'),
    'run.tdms': (lambda: b'TDSm' + bytes(100), 'a TDMS file', '.lvm or .csv'),
    'run.mcap.bak': (lambda: b'\x89MCAP0\r\n' + bytes(100), 'an MCAP file', 'ends in .mcap'),
    'run.sqlite': (lambda: b'SQLite format 3\0' + bytes(100), 'an SQLite', 'ends in .db3'),
}


@pytest.mark.parametrize('name', KINDS)
def test_each_kind_is_named_with_what_to_do(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    make, kind, remedy = KINDS[name]
    path = tmp_path / name
    path.write_bytes(make())
    with pytest.raises(BagError, match='bag must be a rosbag2 folder') as told:
        bag_topics(path)
    assert kind in str(told.value)
    assert remedy in str(told.value)
    asked = (['identify', 'info'], ['identify', 'modal'], ['report', '-o', str(tmp_path / 'out')])
    for words in (words for words in asked if words[0] in verbs()):
        assert main([*words, str(path)]) == 1
        said = capsys.readouterr().err
        assert kind in said
        assert remedy in said
        assert len(said.splitlines()) == 1
