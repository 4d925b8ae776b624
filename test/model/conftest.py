"""A robot with one of everything, and a way to spoil it."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from small_robots import ARM


@pytest.fixture
def arm_text() -> str:
    return ARM


@pytest.fixture
def spoiled() -> Callable[[str, str], str]:
    """Return the robot's text with the first `old` replaced, which must be there."""

    def replace(old: str, new: str) -> str:
        assert old in ARM
        return ARM.replace(old, new, 1)

    return replace
