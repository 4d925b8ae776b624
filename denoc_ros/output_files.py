"""Files that appear whole or not at all; values for YAML and JSON."""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.errors import BagError, ConfigError, DenocError

Document = dict[str, Any]  # of plain values, as JSON and YAML have them


def require_new(*files: Path | None) -> None:
    """Raise BagError where a file that is to be written exists; None counts as none."""
    for file in files:
        if file is not None and file.exists():
            raise BagError(f'{file}: output must not exist yet, got an existing one')


@contextmanager
def whole_file(file: str | os.PathLike[str], parents: bool = False) -> Iterator[Path]:
    """Yield a path to write to, beside the file that it becomes at the end of the block.

    A full disk, an error or Ctrl-C leaves no part of it, and an earlier file stays as it was. It
    has the file's name, and may be made a folder. Devices and pipes are written to directly.

    Parameters
    ----------
    parents : bool
        Make folders that it is to be in and that do not exist.

    Raises
    ------
    OSError
        Of the file, where the system refuses it.
    """
    target = Path(os.path.realpath(file))
    if target.exists() and not (target.is_file() or target.is_dir()):
        yield Path(file)
        return
    beside = None
    try:
        if parents:
            target.parent.mkdir(parents=True, exist_ok=True)
        beside = Path(tempfile.mkdtemp(prefix='.denoc-', dir=target.parent))
        yield beside / target.name
        (beside / target.name).replace(target)
    except DenocError as error:
        error.args = (str(error).replace(f'{beside}{os.sep}', f'{target.parent}{os.sep}'),)
        raise
    except OSError as error:
        if error.filename is None or beside is None or str(beside) in str(error.filename):
            raise type(error)(error.errno, error.strerror or str(error), str(file)) from error
        raise
    finally:
        if beside is not None:
            shutil.rmtree(beside, ignore_errors=True)


def write_text(file: str | os.PathLike[str], text: str) -> None:
    """Write a text file, whole or not at all; ConfigError where it cannot be written."""
    try:
        with whole_file(file) as unfinished:
            unfinished.write_text(text, encoding='utf-8', newline='')
    except OSError as error:
        rule = f'the file must be writable, got: {error.strerror}'
        raise ConfigError(str(file), [rule]) from error


def write_new(file: Path, text: str) -> None:
    """Write a text file; BagError where it exists, ConfigError where it cannot be written."""
    require_new(file)
    write_text(file, text)


def plain(value: Any) -> Any:
    """Return a value of types that YAML and JSON have; a number that is not finite is None."""
    if isinstance(value, np.ndarray):
        return [plain(entry) for entry in value.tolist()]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [plain(entry) for entry in value]
    return value
