"""The result of a verb: numbers for machines, lines for people, the exit status."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from denoc_ros.output_files import plain
from denoc_ros.terminal_text import say


@dataclass(frozen=True)
class VerbResult:
    """Result of a verb, ready to be shown."""

    # as `--json` prints it; numbers that are not finite become null. None: there is nothing.
    document: Mapping[str, Any] | None
    lines: Iterable[str]  # the same for a terminal
    status: int = 0  # exit status
    notes: Iterable[str] = ()  # lines on stderr, whatever is printed

    def show(self, as_json: bool) -> int:
        """Print it and return the exit status."""
        if self.document is not None and as_json:
            say(json.dumps(plain(self.document), indent=2, allow_nan=False))
        else:
            for line in self.lines:
                say(line)
        for note in self.notes:
            say(note, file=sys.stderr)
        return self.status
