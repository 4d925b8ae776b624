"""Files that a command writes and never overwrites."""

from __future__ import annotations

from pathlib import Path


def require_new(*files: Path | None) -> None:
    """Raise BagError where a file that is to be written exists; None counts as none."""
    from denoc_ros.errors import BagError

    for file in files:
        if file is not None and file.exists():
            raise BagError(f'{file}: output must not exist yet, got an existing one')


def write_text(file: Path, text: str) -> None:
    """Write a text file; ConfigError where it cannot be written."""
    from denoc_ros.errors import ConfigError

    try:
        file.write_text(text, encoding='utf-8')
    except OSError as error:
        rule = f'the file must be writable, got: {error.strerror}'
        raise ConfigError(str(file), [rule]) from error


def write_new(file: Path, text: str) -> None:
    """Write a text file; BagError where it exists, ConfigError where it cannot be written."""
    require_new(file)
    write_text(file, text)
