"""One codec for JointState: what is written is read, in any layout and byte order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from denoc_ros.bags.cdr import CdrError, CdrReader
from denoc_ros.bags.definitions import decode, encode, message_types
from denoc_ros.bags.joint_state import (
    FIELDS,
    JOINT_STATE,
    JointStateLayout,
    JointStateMessage,
)
from denoc_ros.bags.series import JointStateColumns
from denoc_ros.types import Array

NAMES = st.lists(st.text(st.characters(codec='utf-8', exclude_characters='\0'), max_size=9))
PRESENT = st.lists(st.sampled_from(FIELDS), unique=True)


def layout_of(raw: bytes) -> JointStateLayout:
    return JointStateLayout.of(CdrReader(raw))


def big_endian(raw: bytes) -> bytes:
    """Return a message's bytes in the other order."""
    message, _ = decode(message_types(), JOINT_STATE, raw)
    return bytes(message_types().serialize_cdr(message, JOINT_STATE, little_endian=False))


def numbered(field: str, count: int) -> Array:
    return np.arange(count, dtype=np.float64) + 10.0 * FIELDS.index(field)


def written(names: Sequence[str], fields: Sequence[str], stamp_ns: int = 7) -> bytes:
    numbers = [numbered(field, len(names)) for field in fields]
    return JointStateMessage(names, fields, 'base').encode(stamp_ns, *numbers)


@settings(max_examples=100, deadline=None)
@given(NAMES, PRESENT, st.booleans(), st.integers(0, 2**31 * 10**9 - 1))
def test_what_is_written_is_read(
    names: list[str], fields: list[str], swapped: bool, stamp_ns: int
) -> None:
    raw = written(names, fields, stamp_ns)
    raw = big_endian(raw) if swapped else raw
    layout = layout_of(raw)
    assert layout.fits(raw)
    assert layout.fits(raw + b'\x07' * 8)  # what rclpy appends
    assert (layout.names, layout.stamp_ns(raw)) == (tuple(names), stamp_ns)
    for field, values in zip(FIELDS, layout.values(raw), strict=True):
        expected = numbered(field, len(names) if field in fields else 0)
        np.testing.assert_array_equal(values, expected)


@settings(max_examples=50, deadline=None)
@given(NAMES, PRESENT)
def test_bytes_are_those_of_the_general_encoder(names: list[str], fields: list[str]) -> None:
    numbers = {field: numbered(field, len(names)) for field in fields}
    header = {'stamp': {'sec': 0, 'nanosec': 7}, 'frame_id': 'base'}
    assert written(names, fields) == encode(
        JOINT_STATE, 0, {'header': header, 'name': names, **numbers}
    )


@pytest.mark.parametrize(
    'other',
    [
        written(['a', 'c'], FIELDS),
        written(['a', 'b'], FIELDS[:2]),
        written(['a', 'b'], FIELDS)[:-1],
        big_endian(written(['a', 'b'], FIELDS)),
        encode(JOINT_STATE, 7, {'name': ['a', 'b'], 'position': [1.0, 2.0]}),
    ],
    ids=['other names', 'fewer fields', 'cut', 'other order', 'other frame'],
)
def test_a_message_of_another_layout_does_not_fit(other: bytes) -> None:
    assert not layout_of(written(['a', 'b'], FIELDS)).fits(other)


@given(st.integers(0, 10_000))
def test_a_cut_message_has_no_layout(cut: int) -> None:
    raw = written(['a', 'b'], FIELDS)
    with pytest.raises(CdrError, match='must'):
        layout_of(raw[: cut % len(raw)])


def test_columns_take_both_byte_orders() -> None:
    columns = JointStateColumns('/joint_states')
    raw = written(['a', 'b'], FIELDS)
    columns.append(raw, 0)
    columns.append(big_endian(raw), 0)
    series = columns.series()
    np.testing.assert_array_equal(series.effort, [[20.0, 21.0], [20.0, 21.0]])
    assert series.stamp_ns.tolist() == [7, 7]
