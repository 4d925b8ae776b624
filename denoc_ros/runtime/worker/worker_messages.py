"""Messages between the node and the process that plans its motions.

A length, a JSON header with the shapes of arrays, then the arrays' bytes: nothing that is read is
ever executed.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np

from denoc_ros.types import Array

_LENGTH = struct.Struct('<Q')
LONGEST_HEADER = 1 << 26  # bytes: a robot's description is in it
LARGEST_ARRAY = 1 << 28  # elements


def write_message(
    stream: BinaryIO, header: Mapping[str, Any], arrays: Mapping[str, Array]
) -> None:
    """Write a header that JSON has words for, and arrays."""
    shapes = {name: list(np.shape(array)) for name, array in arrays.items()}
    text = json.dumps({'header': dict(header), 'shapes': shapes}).encode()
    stream.write(_LENGTH.pack(len(text)) + text)
    for array in arrays.values():
        stream.write(np.ascontiguousarray(array, dtype='<f8').tobytes())
    stream.flush()


def read_message(stream: BinaryIO) -> tuple[dict[str, Any], dict[str, Array]] | None:
    """Return header and arrays; None where the other side has ended.

    Raises
    ------
    ValueError
        What comes is no such message.
    """
    first = _read(stream, _LENGTH.size)
    if first is None:
        return None
    (length,) = _LENGTH.unpack(first)
    if length > LONGEST_HEADER:
        raise ValueError(f'job: a header must have at most {LONGEST_HEADER} bytes, got {length}')
    text = _read(stream, length)
    if text is None:
        return None
    message = json.loads(text)
    arrays = {}
    for name, shape in message['shapes'].items():
        count = int(np.prod(shape, dtype=np.int64))
        if not 0 <= count <= LARGEST_ARRAY:
            raise ValueError(f'job: an array must have at most {LARGEST_ARRAY} elements')
        raw = _read(stream, 8 * count)
        if raw is None:
            return None
        arrays[name] = np.frombuffer(raw, '<f8').reshape(shape).astype(np.float64)
    return message['header'], arrays


def _read(stream: BinaryIO, count: int) -> bytes | None:
    """Return so many bytes, None where the stream ends before."""
    parts = []
    while count > 0:
        part = stream.read(count)
        if not part:
            return None
        parts.append(part)
        count -= len(part)
    return b''.join(parts)
