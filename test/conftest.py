"""Fixtures of all tests."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(scope='session')
def repository() -> Path:
    """Root of the checkout."""
    return Path(__file__).resolve().parent.parent


@pytest.fixture(scope='session')
def shared(repository: Path) -> Path:
    """Folder of the shared cases and reference data, beside the checkout."""
    folder = repository.parent / 'shared'
    assert folder.is_dir(), f'shared data must be beside the repository, got no {folder.name}/'
    return folder
