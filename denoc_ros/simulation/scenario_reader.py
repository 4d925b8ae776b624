"""Read a scenario's values; each violated condition becomes a finding."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from denoc_ros.errors import ConfigError
from denoc_ros.model.mapping_reader import MappingReader, is_number
from denoc_ros.simulation.reference import trajectory_from_config
from denoc_ros.trajectories import Trajectory


class ScenarioReader(MappingReader):
    """Reader of a mapping's values; violations become findings."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        super().__init__()
        self.values = values

    def numbers(self, key: str, default: list[float]) -> list[float]:
        """Return a list of numbers."""
        value = self.values.get(key, default)
        if isinstance(value, (list, tuple)) and all(map(is_number, value)):
            return [float(entry) for entry in value]
        self.find(f'{key} must be finite numbers, got {value!r}')
        return default

    def positive(self, key: str, default: float | None) -> float:
        """Return a number > 0."""
        value = self.values.get(key, default)
        if value is None:
            return 1.0
        if is_number(value) and value > 0.0:
            return float(value)
        self.find(f'{key} must be a number > 0, got {value!r}')
        return 1.0

    def overrides(self, whose: str) -> dict[str, float | list[float]]:
        """Return a mapping of a number, or several, by dotted path."""
        found = dict(self.mapping(whose, self.values.get(whose)))
        for path, value in found.items():
            several = value if isinstance(value, list) and value else [value]
            if not all(map(is_number, several)):
                self.find(f'{whose} {path} must be a finite number or some, got {value!r}')
        return found

    def named_numbers(
        self, whose: str, names: Sequence[str] | None, value: Any = None
    ) -> dict[str, float]:
        """Return a mapping of numbers by name; a list stands for all names in their order."""
        value = self.values.get(whose) if value is None else value
        if isinstance(value, (list, tuple)) and names is not None:
            if len(value) != len(names):
                self.find(f'{whose} must have {len(names)} numbers, got {len(value)}')
                return {}
            value = dict(zip(names, value, strict=True))
        found = {}
        for name, number in self.mapping(whose, value).items():
            if names is not None and name not in names:
                self.find(f'{whose} must name some of {", ".join(names)}, got {name!r}')
            elif not is_number(number):
                self.find(f'{whose} {name} must be a finite number, got {number!r}')
            else:
                found[name] = number  # a number of modes stays whole
        return found

    def trajectory(
        self, value: Any, joints: Sequence[str], whose: str = 'reference'
    ) -> Trajectory | None:
        """Return the trajectory of a mapping, None where it has findings."""
        values = self.mapping(whose, value)
        try:
            return trajectory_from_config(values, joints, whose)
        except ConfigError as error:
            self.findings += [f'{whose}: {finding}' for finding in error.findings]
        return None
