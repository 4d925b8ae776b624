"""The result of a verb: numbers for machines, lines for people, the exit status."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from denoc_ros.output_files import plain


@dataclass(frozen=True)
class VerbResult:
    """Result of a verb, ready to be shown.

    Attributes
    ----------
    document : mapping or None
        As `--json` prints it; numbers that are not finite become null. None: there is nothing.
    lines : iterable of str
        The same for a terminal.
    status : int
        Exit status.
    notes : iterable of str
        Lines on stderr, whatever is printed.
    """

    document: Mapping[str, Any] | None
    lines: Iterable[str]
    status: int = 0
    notes: Iterable[str] = ()

    def show(self, as_json: bool) -> int:
        """Print it and return the exit status."""
        if self.document is not None and as_json:
            print(json.dumps(plain(self.document), indent=2, allow_nan=False))
        else:
            for line in self.lines:
                print(line)
        for note in self.notes:
            print(note, file=sys.stderr)
        return self.status
