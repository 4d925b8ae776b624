"""Bounds for rosbags, which unpacks files and chunks, and reads YAML, of any size.

Its tables and names of modules are the only seams; a test holds that they are still in use.
"""

from __future__ import annotations

import sqlite3
from contextlib import closing
from contextvars import ContextVar
from functools import lru_cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any

from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import metadata, reader, storage_mcap, storage_sqlite3
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from denoc_ros.bags.storage import require_bounded_chunks
from denoc_ros.decompression import (
    WINDOW_BITS,
    BudgetedFile,
    ByteBudget,
    decompressed,
    decompressed_message,
)
from denoc_ros.yaml_text import YamlError, load_yaml

__all__ = ['AnyReader']

# Contents that the file computes when it is read: views, virtual tables, generated columns.
_COMPUTED = """
SELECT name FROM sqlite_master WHERE type = 'view' OR sql LIKE 'CREATE VIRTUAL%'
UNION SELECT m.name FROM sqlite_master m, pragma_table_xinfo(m.name) x
WHERE m.type = 'table' AND x.hidden > 1
"""

# topics have the same few qualities of service, and rosbags changes no value
_value = lru_cache(maxsize=32)(load_yaml)
_zstd = reader.zstd
_budget: ContextVar[ByteBudget] = ContextVar('budget of the bag that is being opened')


class _BoundedYaml(YAML):
    """Reads by `load_yaml`; writes as before."""

    def load(self, stream: Any) -> Any:
        """Return the value of a text; YAMLError for a text that `load_yaml` refuses."""
        try:
            return _value(stream)
        except YamlError as error:
            raise YAMLError(str(error)) from error


class _BoundedFolder(reader.DirectoryReader):
    """Unpacks the compressed files of a folder within one budget."""

    def open(self) -> None:
        """Open all files."""
        folder = Path(self.path)
        compressed = sum(file.stat().st_size for file in folder.iterdir() if file.is_file())
        before = _budget.set(ByteBudget(compressed))
        try:
            super().open()
        finally:
            _budget.reset(before)


class _BoundedMcap(storage_mcap.McapReader):
    """Opens no file whose chunks would fill the memory."""

    def open(self) -> None:
        """Check the chunks, then open the file."""
        require_bounded_chunks(Path(self.path))
        super().open()


class _PlainDatabase(storage_sqlite3.Sqlite3Reader):
    """Opens no database that computes its contents, of any size, when they are read."""

    def open(self) -> None:
        """Check the schema, then open the file."""
        file = Path(self.path)
        if not file.is_file():
            raise ValueError(f'{file.name} must be a regular file, got another kind')
        address = f'{file.resolve().as_uri()}?immutable=1'
        with closing(sqlite3.connect(address, uri=True)) as database:
            computed = database.execute(_COMPUTED).fetchone()
        if computed:
            raise ValueError(f'database must hold plain tables, got {computed[0]!r}')
        super().open()


def _chunk(data: bytes, size: int, *, compression: str) -> bytes:
    return decompressed(data, compression, size)


def _opened(file: IO[bytes], mode: str) -> BudgetedFile:
    options = {_zstd.DecompressionParameter.window_log_max: WINDOW_BITS}
    return BudgetedFile(_zstd.open(file, mode, options=options), _budget.get())


for _kind in ('', 'lz4', 'zstd'):
    storage_mcap.DECOMPRESSORS[_kind] = partial(_chunk, compression=_kind)
reader.zstd = SimpleNamespace(decompress=decompressed_message, open=_opened)
reader.YAML = metadata.YAML = _BoundedYaml
reader.DirectoryReader.STORAGE_PLUGINS.update(mcap=_BoundedMcap, sqlite3=_PlainDatabase)
reader.Reader.STORAGE_PLUGINS.update(
    {'dir': _BoundedFolder, '.mcap': _BoundedMcap, '.db3': _PlainDatabase}
)
