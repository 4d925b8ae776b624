"""Bounds for rosbags, which opens chunks and reads YAML of any size.

Its tables and names of modules are the only seams; a test holds that they are still in use.
"""

from __future__ import annotations

from functools import lru_cache, partial
from types import SimpleNamespace
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import metadata, reader, storage_mcap
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from denoc_ros.bags.storage import decompressed, decompressed_message
from denoc_ros.yaml_text import YamlError, load_yaml

__all__ = ['AnyReader']


# topics have the same few qualities of service, and rosbags changes no value
_value = lru_cache(maxsize=32)(load_yaml)


class _BoundedYaml(YAML):
    """Reads by `load_yaml`; writes as before."""

    def load(self, stream: Any) -> Any:
        """Return the value of a text; YAMLError for a text that `load_yaml` refuses."""
        try:
            return _value(stream)
        except YamlError as error:
            raise YAMLError(str(error)) from error


def _chunk(data: bytes, size: int, *, compression: str) -> bytes:
    return decompressed(data, compression, size)


for _kind in ('', 'lz4', 'zstd'):
    storage_mcap.DECOMPRESSORS[_kind] = partial(_chunk, compression=_kind)
reader.zstd = SimpleNamespace(decompress=decompressed_message, open=reader.zstd.open)
reader.YAML = metadata.YAML = _BoundedYaml
