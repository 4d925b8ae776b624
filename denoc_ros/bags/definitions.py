"""Message definitions and CDR without ROS, which make a bag readable by every tool."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import (
    Stores,
    TypesysError,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)

from denoc_ros.errors import BagError

_NS = 1_000_000_000
_ENCAPSULATION = 4
_DTYPES = {'byte': 'uint8', 'octet': 'uint8', 'char': 'uint8'}


class DefinitionError(BagError):
    """The definition of a message type is damaged, or lacks a part: others can be read."""


@lru_cache(maxsize=1)
def message_types() -> Any:
    """Return the typestore of ROS 2 Jazzy, which grows by installed types when they are needed."""
    return get_typestore(Stores.ROS2_JAZZY)


@lru_cache(maxsize=256)
def types_of(type_name: str, encoding: str, text: str) -> Any:
    """Return a typestore that has a type as a file defines it.

    Parameters
    ----------
    encoding : str
        `ros2msg` or `ros2idl`; for any other, or without a text, the type is the installed one.
    text : str
        The definition. Types that it uses and does not define are the installed ones.

    Raises
    ------
    DefinitionError
        When the definition is not valid, or a type is neither defined nor installed.
    """
    try:
        if encoding not in _PARSERS or not text.strip():
            require_type(type_name)
            return message_types()
        found = _PARSERS[encoding](text, type_name)
        wanted = [type_name]
        known: dict[str, Any] = {}
        while wanted:
            name = wanted.pop()
            if name in known:
                continue
            if name not in found:
                require_type(name)
            known[name] = found[name] if name in found else message_types().fielddefs[name]
            wanted.extend(_nested(known[name][1]))
        store = get_typestore(Stores.EMPTY)
        store.register(known)
    except BagError as error:
        rule = f'{type_name}: definition must be whole, got one without {error}'
        raise DefinitionError(rule) from error
    except Exception as error:  # the parser ends damaged texts in errors of several kinds
        raise DefinitionError(f'{type_name}: definition must be valid, got: {error}') from error
    return store


def _types_of_idl(text: str, _: str) -> Any:
    """Return the types of an IDL text, or of several with a line of 80 `=` before each."""
    found: dict[str, Any] = {}
    for part in text.split(f'{"=" * 80}\n'):
        body = part.partition('\n')[2] if part.startswith('IDL: ') else part
        found.update(get_types_from_idl(body) if body.strip() else {})
    return found


_PARSERS: dict[str, Callable[[str, str], Any]] = {
    'ros2msg': get_types_from_msg,
    'ros2idl': _types_of_idl,
    'omgidl': _types_of_idl,
}


def message_definition(type_name: str) -> str:
    """Return a type's full ros2msg text, the sections of its dependencies included.

    Parameters
    ----------
    type_name : str
        `package/msg/Name`. Types beyond the common interfaces are looked up below
        `share/package/msg` of every prefix in AMENT_PREFIX_PATH.
    """
    require_type(type_name)
    text, _ = message_types().generate_msgdef(type_name, ros_version=2)
    return str(text)


def encode(type_name: str, stamp_ns: int, fields: Mapping[str, Any]) -> bytes:
    """Return the CDR bytes of a message given by its fields.

    Parameters
    ----------
    stamp_ns : int
        Goes into `header.stamp` of a type with a header that is not among the fields [ns].
    fields : mapping
        Values by field name: numbers, strings, sequences, arrays, mappings for nested messages.
        Left out fields are zero or empty.

    Raises
    ------
    BagError
        When the type is unknown, or has no such field, or cannot hold such a value.
    """
    require_type(type_name)
    names = [name for name, _ in message_types().fielddefs[type_name][1]]
    if 'header' in names and 'header' not in fields:
        stamp = {'sec': stamp_ns // _NS, 'nanosec': stamp_ns % _NS}
        fields = {'header': {'stamp': stamp}, **fields}
    message = _message(type_name, fields)
    try:
        return bytes(message_types().serialize_cdr(message, type_name))
    except Exception as error:
        raise BagError(f'{type_name}: fields must fit the type, got {error}') from error


def decode(types: Any, type_name: str, raw: bytes) -> tuple[Any, int]:
    """Return a message and the number of its bytes that mean something.

    Parameters
    ----------
    raw : bytes
        CDR. What rclpy's `serialize_message` appends to it (up to 8 uninitialised bytes, at
        which rosbags itself takes offence) is passed over.
    """
    if len(raw) < _ENCAPSULATION or raw[0] != 0 or raw[1] not in (0, 1):
        raise BagError(f'{type_name}: bytes must begin as plain CDR, got {bytes(raw[:4]).hex()}')
    form = types.get_msgdef(type_name)
    read = form.deserialize_cdr_le if raw[1] else form.deserialize_cdr_be
    message, end = read(raw[_ENCAPSULATION:], 0, form.cls, types)
    return message, end + _ENCAPSULATION


def exact_cdr(type_name: str, raw: bytes) -> bytes:
    """Remove the meaningless bytes from the output of rclpy's `serialize_message`.

    The bytes that it appends are left out, and those between fields are zero: it leaves them as
    they were in memory, and two runs would differ.
    """
    require_type(type_name)
    message, _ = decode(message_types(), type_name, raw)
    return bytes(message_types().serialize_cdr(message, type_name))


def require_type(type_name: str) -> None:
    """Make a type and all that it consists of known, or raise BagError."""
    if type_name not in message_types().fielddefs:
        _register(type_name)


def _register(type_name: str) -> None:
    known = message_types().fielddefs
    found: dict[str, Any] = {}
    wanted = [type_name]
    while wanted:
        name = wanted.pop()
        if name in known or name in found:
            continue
        text = _definition_file(name).read_text(encoding='utf-8')
        try:
            found.update(get_types_from_msg(text, name))
        except TypesysError as error:
            raise BagError(f'{name}: definition must be valid, got {error}') from error
        wanted.extend(_nested(found[name][1]))
    message_types().register(found)


def _definition_file(type_name: str) -> Path:
    package, _, name = type_name.partition('/msg/')
    prefixes = [
        *filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)),
        sys.prefix,
    ]
    for prefix in prefixes:
        path = Path(prefix, 'share', package, 'msg', f'{name}.msg')
        if name and path.is_file():
            return path
    raise BagError(
        f'{type_name}: message definition must be installed: no share/{package}/msg/{name}.msg '
        f'below {", ".join(prefixes)}'
    )


def _nested(fields: list[Any]) -> Iterator[str]:
    for _, (kind, detail) in fields:
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            kind, detail = detail[0]
        if kind == Nodetype.NAME:
            yield detail


def _message(type_name: str, fields: Mapping[str, Any]) -> Any:
    definition = message_types().fielddefs[type_name][1]
    unknown = sorted(set(fields) - {name for name, _ in definition})
    if unknown:
        raise BagError(
            f'{type_name}: fields must be among '
            f'{", ".join(name for name, _ in definition)}, got {", ".join(unknown)}'
        )
    values = {name: _value(form, fields.get(name)) for name, form in definition}
    return message_types().types[type_name](**values)


def _value(form: Any, given: Any) -> Any:
    kind, detail = form
    if kind == Nodetype.NAME:
        return (
            _message(detail, given or {}) if given is None or isinstance(given, Mapping) else given
        )
    if kind == Nodetype.BASE:
        return _zero(detail[0]) if given is None else given
    element, length = detail
    if given is None:
        given = [None] * length if kind == Nodetype.ARRAY else []
    if element[0] == Nodetype.BASE and not element[1][0].endswith('string'):
        dtype = _DTYPES.get(element[1][0], element[1][0])
        return np.array([0 if item is None else item for item in given], dtype=dtype)
    return [_value(element, item) for item in given]


def _zero(base: str) -> Any:
    if base.endswith('string'):
        return ''
    return 0.0 if base.startswith('float') else 0
