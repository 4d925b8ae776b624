"""A recording is known by its bytes."""

from __future__ import annotations

from pathlib import Path

from denoc_ros.bags.digest import file_hash


def test_the_hash_is_of_the_bytes(tmp_path: Path) -> None:
    first, second = tmp_path / 'a', tmp_path / 'b'
    for folder in (first, second):
        folder.mkdir()
        (folder / 'x.mcap').write_bytes(b'1')
    assert file_hash(first) == file_hash(second)
    (second / 'x.mcap').write_bytes(b'2')
    assert file_hash(first) != file_hash(second)
