"""A robot model whose parameters change while nodes run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ModelError
from denoc_ros.model.numbers import Values, numbers_of, other_names, plain_paths, values_of
from denoc_ros.model.reading.source import is_text, parse_xml
from denoc_ros.runtime.inputs.input_monitor import InputError

Given = TypeVar('Given')


class LiveModel:
    """Makes robots with overrides; numbers cost no new model."""

    def __init__(self, base: Robot) -> None:
        self._base = base
        self._overrides: dict[str, Any] = {}
        self._built, self._numbers = base, numbers_of(base.tree)
        self._values, self._names = values_of(base.tree), other_names(self._numbers)

    def plain(self, overrides: Mapping[str, Given]) -> dict[str, Given]:
        """Return values with the aliases `damping.*` replaced by the paths that they stand for.

        Raises
        ------
        ConfigError
            Different values under two names of one number.
        """
        return plain_paths(self._numbers, overrides)

    def robot(self, overrides: Mapping[str, Any]) -> Robot:
        """Return a robot with overrides and a workspace of its own.

        Raises
        ------
        ConfigError, ModelError
            A path that names nothing, or a value that makes no model.
        """
        plain = self.plain(overrides)
        if plain != self._overrides:
            self._built, self._overrides = self._changed(plain), plain
            self._values = values_of(self._built.tree)
        return self._built.copy()

    def _changed(self, overrides: Mapping[str, Any]) -> Robot:
        """Return the robot with overrides that are not those of the last one."""
        before = self._overrides
        if before.keys() - overrides.keys():
            return self._base.with_overrides(overrides) if overrides else self._base
        # the others stay: what changes may be little
        changed = {path: v for path, v in overrides.items() if before.get(path) != v}
        return self._built.with_overrides(changed)

    def values(self, overrides: Mapping[str, Any]) -> Values:
        """Return all numbers that overrides can change, by every name, with the overrides applied.

        The overrides are those that the last `robot` was made with.
        """
        values: Values = {**self._values, **self.plain(overrides)}
        return values | {name: values[path] for name, path in self._names.items()}


def check_description(topic: str, text: str) -> None:
    """Refuse text that is not a description: a path from a topic is never opened.

    Raises
    ------
    InputError
        Cause `format`: the text is not the XML of a `<robot>`.
    """
    if not is_text(text):
        got = f'{len(text)} characters that begin with {text[:20]!r}'
        raise InputError('format', f'{topic} must be the XML of a <robot>, got {got}')
    try:
        parse_xml(topic, text)
    except ModelError as error:
        raise InputError('format', str(error)) from error
