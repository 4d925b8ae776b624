"""Mutations of real files: what a slip of the hand, a broken disk or malice makes of them."""

from __future__ import annotations

import re
from collections.abc import Callable

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

# the same examples every time; the profile `fuzz` draws many more, and others
# each example writes over the files of the one before
FUZZ = settings(
    max_examples=settings().max_examples // 3,
    deadline=None,
    derandomize=settings.get_current_profile_name() != 'fuzz',
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
NUMBER = re.compile(r'(?<=["\s])-?\d+\.?\d*(?:[eE][-+]?\d+)?(?=["\s])')
VALUE = re.compile(r'"[^"<>]*"')
ELEMENT = re.compile(r'<[A-Za-z_]+(?:\s[^<>]*)?/>')
TAG = re.compile(r'</?[A-Za-z_]+[^<>]*>')
STRANGE_NUMBERS = (
    'nan', '-inf', 'inf', '1e309', '-1e309', '1e200', '-1e200', '1e-320', '1e-200', '0', '-0.0',
    '-1', '1', '1e9', '-1e9', '0x10', '1_0', '1,5', '', ' ', '٣', '1e', '--1', '9' * 400,
)  # fmt: skip
STRANGE_VALUES = ('""', '"-"', '"base"', '"y"', '"\u2028"', '"&lt;"', '"' + 'x' * 5000 + '"')
STRANGE_TEXT = (
    '<!DOCTYPE robot [<!ENTITY a "b">]>', '<!ENTITY a "b">', '&a;', '&#0;', '&#x10FFFF;',
    '<![CDATA[', ']]>', '<?xml version="1.1"?>', '<!--', '-->', '\x00', '\ufeff', '<link', 'ö',
    '</robot>', '<mimic/>', '<flexibility/>', '<beam link="base"/>',
)  # fmt: skip

Change = Callable[[str, st.DataObject], str]


def _spot(pattern: re.Pattern[str], text: str, data: st.DataObject) -> tuple[int, int] | None:
    """Return where one match of a pattern, drawn, begins and ends."""
    spots = [match.span() for match in pattern.finditer(text)]
    return data.draw(st.sampled_from(spots)) if spots else None


def _replaced(pattern: re.Pattern[str], choices: tuple[str, ...]) -> Change:
    def change(text: str, data: st.DataObject) -> str:
        spot = _spot(pattern, text, data)
        if spot is None:
            return text
        return text[: spot[0]] + data.draw(st.sampled_from(choices)) + text[spot[1] :]

    return change


def _repeated(pattern: re.Pattern[str]) -> Change:
    """Move or copy one match of a pattern to the place of another."""

    def change(text: str, data: st.DataObject) -> str:
        source, target = _spot(pattern, text, data), _spot(pattern, text, data)
        if source is None or target is None:
            return text
        return text[: target[0]] + text[source[0] : source[1]] + text[target[1] :]

    return change


def _number_drawn(text: str, data: st.DataObject) -> str:
    spot = _spot(NUMBER, text, data)
    if spot is None:
        return text
    number = data.draw(st.floats(allow_nan=False, allow_infinity=False))
    return f'{text[: spot[0]]}{number!r}{text[spot[1] :]}'


def _inserted(text: str, data: st.DataObject) -> str:
    spot = data.draw(st.integers(0, len(text)))
    return text[:spot] + data.draw(st.sampled_from(STRANGE_TEXT)) + text[spot:]


def _cut(text: str, data: st.DataObject) -> str:
    begin = data.draw(st.integers(0, len(text)))
    return text[:begin] + text[data.draw(st.integers(begin, len(text))) :]


CHANGES: tuple[Change, ...] = (
    _replaced(NUMBER, STRANGE_NUMBERS),
    _replaced(NUMBER, STRANGE_NUMBERS),
    _number_drawn,
    _number_drawn,
    _replaced(VALUE, STRANGE_VALUES),
    _replaced(ELEMENT, ('',)),
    _replaced(TAG, ('',)),
    _repeated(VALUE),
    _repeated(ELEMENT),
    _repeated(TAG),
    _inserted,
    _cut,
)


def changed_text(text: str, data: st.DataObject) -> str:
    """Return a text with one to four changes."""
    for change in data.draw(st.lists(st.sampled_from(CHANGES), min_size=1, max_size=4)):
        text = change(text, data)
    return text


def changed_bytes(content: bytes, data: st.DataObject) -> bytes:
    """Return a file with bytes overwritten, cut out or doubled, and perhaps cut off."""
    changed = bytearray(content)
    for _ in range(data.draw(st.integers(1, 6))):
        spot = data.draw(st.integers(0, max(0, len(changed) - 1)))
        kind = data.draw(st.sampled_from(['byte', 'number', 'cut', 'double', 'end']))
        size = data.draw(st.integers(1, 64))
        if kind == 'byte':
            changed[spot : spot + 1] = data.draw(st.binary(min_size=1, max_size=1))
        elif kind == 'number':  # lengths and offsets are little-endian words
            word = data.draw(st.sampled_from([0, 1, 2**31 - 1, 2**32, 2**40, 2**63, 2**64 - 1]))
            changed[spot : spot + 8] = word.to_bytes(8, 'little')
        elif kind == 'cut':
            del changed[spot : spot + size]
        elif kind == 'double':
            changed[spot:spot] = changed[spot : spot + size]
        else:
            del changed[spot:]
    return bytes(changed)
