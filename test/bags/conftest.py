"""Bags that several tests write and read."""

from __future__ import annotations

from pathlib import Path

import pytest

SHARED_BAGS = Path(__file__).parents[2].parent / 'shared' / 'data' / 'ros2_bags'


@pytest.fixture
def shared_bags() -> Path:
    """Return the folder of recorded bags beside the project."""
    return SHARED_BAGS
