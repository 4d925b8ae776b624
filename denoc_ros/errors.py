"""The errors of the package, one small class per role."""

from __future__ import annotations

from collections.abc import Sequence


class DenocError(Exception):
    """Base of all errors that this package raises on purpose."""


class FindingsError(DenocError):
    """A file or table is bad: every finding, gathered, in one error.

    Attributes
    ----------
    where : str
        The file or text that was read.
    findings : tuple of str
        Each says `whose what must …, got …`.
    """

    def __init__(self, where: str, findings: Sequence[str]) -> None:
        self.where = where
        self.findings = tuple(findings)
        super().__init__('\n'.join(f'{where}: {finding}' for finding in self.findings))

    @classmethod
    def raise_any(cls, where: str, findings: Sequence[str]) -> None:
        """Raise the error with the findings, if there are any."""
        if findings:
            raise cls(where, findings)


class ModelError(FindingsError):
    """A robot description does not give a model."""


class ConfigError(FindingsError):
    """A configuration, scenario or table file is not valid."""


class StateError(DenocError):
    """An argument has a wrong shape or type, or is not finite."""


class SolverError(DenocError):
    """A solver found no solution; the message has the relevant number."""


class BagError(DenocError):
    """A bag cannot be read or written."""


class IdentificationError(DenocError):
    """A record does not identify the requested quantity."""
