"""A disk that takes nothing until it is released."""

from __future__ import annotations

import threading

import pytest

from denoc_ros.bags.storage import DiskFile


def freeze_disk(monkeypatch: pytest.MonkeyPatch, patience: float = 30.0) -> threading.Event:
    """Let every write wait until the event that is returned is set; fail after `patience` [s]."""
    released = threading.Event()
    write = DiskFile.write

    def frozen_write(disk: DiskFile, block: bytes) -> int:
        assert released.wait(patience)
        return write(disk, block)

    monkeypatch.setattr(DiskFile, 'write', frozen_write)
    return released
