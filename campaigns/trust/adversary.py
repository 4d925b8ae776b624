"""Values that nobody should send, and messages of any type made of them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message

FLOATS = (
    0.0, -0.0, 5e-324, -5e-324, 2.3e-308, 1e-300, -1e-12, 0.3, -1.0, math.pi, 7.0, 1e2, -1e3, 1e4,
    -1e5, 1e6, 1e12, 1e150, -1e300, 1.7e308, -1.7e308, math.nan, math.inf, -math.inf,
)  # fmt: skip
FLOATS_32 = tuple(x for x in FLOATS if not math.isfinite(x) or abs(x) < 3e38)
# transitions that are none, parameter types that are none, nanoseconds that are whole seconds
INTEGERS = (0, 1, 2, 3, 5, 77, 99, 255, 256, 999_999_999, 1_000_000_000, 4_294_967_295, -1, -7)
WORDS = (
    '', ' ', '/', '~', '..', '%s%n', 'nan', '/dev/zero', 'ä€😀', 'x' * 300, 'y' * 5000,
    'z' * 1_000_000,
)  # fmt: skip
SEQUENCE = re.compile(r'sequence<(?P<of>.+?)(?:, *(?P<most>\d+))?>$')
ARRAY = re.compile(r'(?P<of>.+)\[(?P<count>\d+)\]$')
NUMBER = re.compile(r'(?P<sign>u?)int(?P<bits>\d+)$')
# how often a sequence has so many elements: mostly as many as there are joints, now and then many
COUNTS, SHARES = (0, 1, 2, 3, 7, 300), (0.12, 0.2, 0.4, 0.18, 0.07, 0.03)
LONG_WORD = 0.03  # share of strings that may be a megabyte

Special = Callable[['Adversary'], Any]


@cache
def interface(name: str) -> Any:
    """Return the class of `package/msg/Type`, `package/srv/Type` or `package/Type`."""
    package, *middle, kind = name.split('/')
    return getattr(import_module(f'{package}.{middle[0] if middle else "msg"}'), kind)


@dataclass
class Adversary:
    """Draws values; the same seed draws the same.

    Parameters
    ----------
    rng : Generator
    words : sequence of str
        Names that mean something to who is attacked; drawn as often as strange ones.
    special : mapping of str to callable
        What to draw instead of a random message of a type (`package/Type`).
    """

    rng: np.random.Generator
    words: Sequence[str] = ()
    special: Mapping[str, Special] = field(default_factory=dict)

    def one_of(self, choices: Sequence[Any]) -> Any:
        return choices[int(self.rng.integers(len(choices)))]

    def chance(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def real(self, choices: Sequence[float] = FLOATS) -> float:
        if self.chance(0.3):
            return float(np.float32(self.rng.normal()))
        return float(self.one_of(choices))

    def integer(self, bits: int, signed: bool) -> int:
        """Return one of the interesting integers that fit, or of the ends of the range."""
        low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
        fitting = [value for value in INTEGERS if low <= value <= high]
        return int(self.one_of([*fitting, low, high, int(self.rng.integers(0, 13))]))

    def text(self) -> str:
        if self.words and self.chance(0.6):
            return str(self.one_of(self.words))
        return str(self.one_of(WORDS if self.chance(LONG_WORD) else WORDS[:-1]))

    def count(self) -> int:
        return int(self.rng.choice(COUNTS, p=SHARES))

    def value(self, kind: str) -> Any:
        """Return a value of a field of a type as `get_fields_and_field_types` names it."""
        if found := SEQUENCE.match(kind):
            most = int(found['most'] or COUNTS[-1])
            return self.several(found['of'], min(self.count(), most))
        if found := ARRAY.match(kind):
            return self.several(found['of'], int(found['count']))
        if found := NUMBER.match(kind):
            return self.integer(int(found['bits']), not found['sign'])
        if kind == 'boolean':
            return self.chance(0.5)
        if kind in ('double', 'float', 'long double'):
            return self.real(FLOATS_32 if kind == 'float' else FLOATS)
        if kind in ('octet', 'byte'):
            return bytes([self.integer(8, False)])
        if kind == 'char':
            return self.integer(8, False)
        if kind.startswith(('string', 'wstring')):
            return self.text()
        return self.message(kind)

    def several(self, kind: str, count: int) -> list[Any]:
        """Return so many values, now and then all the same."""
        if '/' in kind:
            count = min(count, 7)
        if count and self.chance(0.2):
            return [self.value(kind)] * count
        return [self.value(kind) for _ in range(count)]

    def message(self, name: str, cls: Any = None) -> Any:
        """Return a message of a type, every field of it drawn."""
        if name in self.special:
            return self.special[name](self)
        cls = interface(name) if cls is None else cls
        made = cls()
        for attribute, kind in cls.get_fields_and_field_types().items():
            setattr(made, attribute, self.value(kind))
        return made

    def spoil(self, message: Any) -> None:
        """Draw one to three fields of a good message anew."""
        places = list(leaves(message))
        for _ in range(int(self.rng.integers(1, 4))):
            owner, attribute, kind = self.one_of(places)
            setattr(owner, attribute, self._instead(getattr(owner, attribute), kind))

    def _instead(self, before: Any, kind: str) -> Any:
        """Return another value; of numbers in a sequence often as many as there were."""
        found = SEQUENCE.match(kind)
        if found is None or not len(before) or self.chance(0.25):
            return self.value(kind)
        values = list(before)
        if self.chance(0.3):
            return [self.value(found['of'])] * len(values)
        for place in self.rng.choice(
            len(values), int(self.rng.integers(1, len(values) + 1)), False
        ):
            values[int(place)] = self.value(found['of'])
        return values

    def spoil_bytes(self, raw: bytes) -> bytes:
        """Cut a serialized message off, or write random bytes into it."""
        if self.chance(0.5):
            return raw[: int(self.rng.integers(4, len(raw) + 1))]
        spoilt = bytearray(raw)
        for _ in range(int(self.rng.integers(1, 9))):
            spoilt[int(self.rng.integers(4, len(raw)))] = int(self.rng.integers(256))
        return bytes(spoilt)

    def sent(self, name: str, good: Any) -> Any:
        """Return a message or bytes to send: a good one, spoilt, or one drawn as a whole.

        Parameters
        ----------
        name : str
            Type, `package/msg/Type`.
        good : message
            Is changed.
        """
        if self.chance(0.25):
            return self.message(name.replace('/msg/', '/'))
        if self.chance(0.15):
            return self.spoil_bytes(bytes(serialize_message(good)))
        self.spoil(good)
        return good


def leaves(message: Any) -> Iterator[tuple[Any, str, str]]:
    """Yield (owner, field, type) of all fields that hold no message, and of all sequences."""
    for attribute, kind in message.get_fields_and_field_types().items():
        value = getattr(message, attribute)
        if hasattr(value, 'get_fields_and_field_types'):
            yield from leaves(value)
            continue
        yield message, attribute, kind
        if SEQUENCE.match(kind) and len(value) and hasattr(value[0], 'get_fields_and_field_types'):
            for each in value[:3]:
                yield from leaves(each)
