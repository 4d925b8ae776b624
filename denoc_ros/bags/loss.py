"""Detection of lost files: deleted, moved, replaced or cut during the recording."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timezone
from itertools import count
from pathlib import Path

from denoc_ros.bags.metadata import FileContents

MOVED = 'a moved or renamed one'


@dataclass(frozen=True)
class Identity:
    """Which file or folder a path led to when it was made."""

    device: int
    number: int

    @classmethod
    def of(cls, status: os.stat_result) -> Identity:
        """Return the identity that a status tells."""
        return cls(status.st_dev, status.st_ino)

    def is_at(self, path: Path) -> bool:
        """Say whether a path leads there still; True where the system does not tell."""
        try:
            return Identity.of(path.stat()) == self
        except (FileNotFoundError, NotADirectoryError):
            return False
        except OSError:
            return True


def displacement(path: Path, size: int) -> str:
    """Fate of a finished file of a size [bytes]: deleted, moved, cut; '' when unchanged."""
    try:
        found = path.stat().st_size
    except (FileNotFoundError, NotADirectoryError):
        return 'a deleted or moved one'
    except OSError:  # the system does not tell
        return ''
    return '' if found == size else cut(found, size)


def cut(found: int, written: int) -> str:
    """Say that a file does not have the bytes that were written."""
    return f'one of {found} bytes instead of {written}'


@dataclass(frozen=True)
class Loss:
    """A file of a bag that was moved, deleted or damaged during the recording.

    Attributes
    ----------
    path : Path
        Where it was.
    cause : str
        What became of it.
    contents : FileContents
        What had been written to it.
    next_path : Path, optional
        The file in which the recording goes on.
    """

    path: Path
    cause: str
    contents: FileContents
    next_path: Path | None = None

    def __str__(self) -> str:
        """Return the event and the loss as a message to the user."""
        held = self.contents
        text = (
            f'{self.path}: file must stay as it is written, got {self.cause}; '
            f'{held.messages} messages, {held.size} bytes'
        )
        if held.messages:
            begin = datetime.fromtimestamp(held.start_ns // 10**9, timezone.utc)
            span = 1e-9 * (held.end_ns - held.start_ns)
            text += f', {span:.2f} s from {begin:%Y-%m-%d %H:%M:%S} UTC'
        text += ' are whole in it, not in this bag' if self.cause == MOVED else ' are lost'
        return f'{text}; goes on in {self.next_path}' if self.next_path else text


def free_paths(path: Path, suffix: str) -> Iterator[Path]:
    """Yield paths for a recording whose folder or file is gone: names by time."""
    name = f'{path.name.removesuffix(suffix)}_{time.strftime("%Y%m%d_%H%M%S")}'
    yield path.with_name(f'{name}{suffix}')
    for number in count(2):
        yield path.with_name(f'{name}_{number}{suffix}')
