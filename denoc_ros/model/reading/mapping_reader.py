"""Read the mapping of a YAML file; each violated condition becomes a finding."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from denoc_ros.errors import ConfigError

Rule = tuple[Callable[[Any], bool], str]  # whether a value is good, and the rule in words


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

    def check(self, whose: str, values: Mapping[str, Any], rules: Mapping[str, Rule]) -> None:
        """Find values that break the rule of their name; one that is not there breaks none."""
        for name, (is_good, words) in rules.items():
            if name in values and not is_good(values[name]):
                self.fail(f'{whose}{name}', f'be {words}', values[name])

    def check_all(self, whose: str, value: Any, rule: Rule) -> None:
        """Find values of a mapping that break a rule."""
        inside = self.mapping(whose, value)
        self.check(f'{whose}.', inside, dict.fromkeys(inside, rule))

    def entries(self, whose: str, value: Any) -> Iterator[tuple[str, Any]]:
        """Yield the entries of a list, each with its place in words; none where there is none."""
        if value is not None and not isinstance(value, list):
            self.fail(whose, 'be a list', value)
        elif value:
            yield from ((f'{whose}[{k}]', entry) for k, entry in enumerate(value))

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


TEXT: Rule = (lambda value: isinstance(value, str), 'a text')
NUMBER: Rule = (is_number, 'a finite number')
