"""Files that a command writes and never overwrites."""

from __future__ import annotations

from pathlib import Path


def write_new(file: Path, text: str) -> None:
    """Write a text file.

    Raises
    ------
    ConfigError
        It exists, or cannot be written.
    """
    from denoc_ros.errors import ConfigError

    try:
        with file.open('x', encoding='utf-8') as stream:
            stream.write(text)
    except FileExistsError as error:
        rule = 'output must not exist yet, got an existing one'
        raise ConfigError(str(file), [rule]) from error
    except OSError as error:
        rule = f'the file must be writable, got: {error.strerror}'
        raise ConfigError(str(file), [rule]) from error
