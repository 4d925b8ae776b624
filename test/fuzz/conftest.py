"""The long form of fuzzing: `python -m campaigns fuzz` has the same tests, profile `fuzz`."""

from __future__ import annotations

from hypothesis import settings

settings.register_profile('fuzz', max_examples=4000, deadline=None, print_blob=True)
