"""Read the mapping of a YAML file; each violated condition becomes a finding."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

from denoc_ros.errors import ConfigError


class MappingReader:
    """Reader of a configuration that gathers findings; it goes on after a wrong value."""

    def __init__(self, findings: list[str] | None = None) -> None:
        self.findings = [] if findings is None else findings

    def find(self, text: str) -> None:
        """Note a finding."""
        self.findings.append(text)

    def fail(self, whose: str, rule: str, got: object) -> None:
        """Note that something must be something else."""
        self.find(f'{whose} must {rule}, got {got!r}')

    def finish(self, where: str) -> None:
        """Raise the findings, if any."""
        ConfigError.raise_any(where, self.findings)

    def only(self, whose: str, values: Mapping[Any, Any], known: Sequence[str]) -> None:
        """Find keys that are not known."""
        for key in values:
            if key not in known:
                self.fail(f"{whose}'s keys", f'be of {", ".join(known)}', key)

    def mapping(self, whose: str, value: Any) -> Mapping[str, Any]:
        """Return a mapping, empty where there is none."""
        if value is None:
            return {}
        if isinstance(value, Mapping):
            return value
        self.fail(whose, 'be a mapping', value)
        return {}


def is_number(value: Any) -> bool:
    """Say whether a value is a finite number."""
    is_real = isinstance(value, (int, float)) and not isinstance(value, bool)
    return is_real and abs(value) <= sys.float_info.max


def are_numbers(value: Any) -> bool:
    """Say whether a value is a list of one finite number or more."""
    return isinstance(value, list) and len(value) > 0 and all(map(is_number, value))
