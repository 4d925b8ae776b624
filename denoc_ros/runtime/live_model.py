"""A robot model whose parameters change while nodes run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError, StateError
from denoc_ros.model.override_values import Values, override_values
from denoc_ros.model.overrides import damping_names, payloads_of, plain_paths

PAYLOAD = 'payload.'
Given = TypeVar('Given')


class LiveModel:
    """Makes robots with overrides; payloads cost no new model.

    Parameters
    ----------
    base : Robot
        The robot without overrides.
    where : str
        Whose parameters the overrides are, for messages.
    """

    def __init__(self, base: Robot, where: str) -> None:
        self._base = base
        self._where = where
        self._names = damping_names(base.tree)
        self._overrides: dict[str, Any] = {}
        self._built, self._values = base, override_values(base.tree)

    def plain(self, overrides: Mapping[str, Given]) -> dict[str, Given]:
        """Return values with the aliases `damping.*` replaced by the paths that they stand for.

        Raises
        ------
        ConfigError
            Different values under two names of one number.
        """
        return plain_paths(self._names, overrides)

    def robot(self, overrides: Mapping[str, Any]) -> Robot:
        """Return a robot with overrides and a workspace of its own.

        Raises
        ------
        ConfigError, ModelError
            A path that names nothing, or a value that makes no model.
        """
        plain = self.plain(overrides)
        payloads = {path: value for path, value in plain.items() if path.startswith(PAYLOAD)}
        rest = {path: value for path, value in plain.items() if path not in payloads}
        if rest != self._overrides:
            built = self._base.with_overrides(rest) if rest else self._base
            self._built, self._values = built, override_values(built.tree)
            self._overrides = rest
        robot = self._built.copy()
        for link, payload in payloads_of(payloads, robot.tree).items():
            try:
                robot.set_payload(link, payload.mass, payload.com, payload.inertia)
            except StateError as error:
                raise ConfigError(self._where, [f"parameter 'payload.{link}': {error}"]) from error
        return robot

    def values(self, overrides: Mapping[str, Any]) -> Values:
        """Return all numbers that overrides can change, by every name, with the overrides applied.

        The overrides are those that the last `robot` was made with.
        """
        values = dict(self._values)
        values.update(self.plain(overrides))
        values.update({name: values[path] for name, path in self._names.items() if path in values})
        return values
