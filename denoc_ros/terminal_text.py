"""The one printer: text from files and messages reaches a terminal without its control characters.

A name in a recording may hold escape sequences, which would move the cursor, change colours or
retitle the window; marks of direction would show a line in another order than it has.
"""

from __future__ import annotations

from typing import IO, Any

_CONTROLS = (*range(0x20), *range(0x7F, 0xA0))  # C0, DEL and C1
_DIRECTIONS = (0x061C, 0x200E, 0x200F, *range(0x202A, 0x202F), *range(0x2066, 0x206A))
_SEPARATORS = (0x2028, 0x2029)  # of lines and paragraphs
_IN_CELL = {
    code: f'\\x{code:02x}' if code < 0x100 else f'\\u{code:04x}'
    for code in (*_CONTROLS, *_DIRECTIONS, *_SEPARATORS)
}
_IN_TEXT = {code: text for code, text in _IN_CELL.items() if chr(code) not in '\n\t'}


def visible(text: str) -> str:
    r"""Return a text whose control characters are shown, such as `\x1b`; lines and tabs stay."""
    return text.translate(_IN_TEXT)


def visible_cell(text: str) -> str:
    """Return a text that is a part of one line: ends of lines and tabs are shown as well."""
    return text.translate(_IN_CELL)


def say(
    *values: object, end: str = '\n', file: IO[str] | None = None, flush: bool = False
) -> None:
    """Print as `print` does, with the control characters shown."""
    print(*(visible(str(value)) for value in values), end=end, file=file, flush=flush)


def visible_record(record: Any) -> bool:
    """Show the control characters of a record of `logging`: a filter of a handler."""
    record.msg, record.args = visible(record.getMessage()), ()
    return True
