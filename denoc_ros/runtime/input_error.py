"""The error of a refused input message, and what makes one too long."""

from __future__ import annotations

MOST_JOINTS = 256  # in one message: names are read one by one
LONGEST_TEXT = 500  # characters of a refusal: what came may be megabytes


class InputError(Exception):
    """An input message is refused; `cause` is the word it is counted under."""

    def __init__(self, cause: str, message: str) -> None:
        self.cause = cause
        short = len(message) <= LONGEST_TEXT
        super().__init__(message if short else message[: LONGEST_TEXT - 1] + '…')
