"""Digest that identifies a recording."""

from __future__ import annotations

import hashlib
from pathlib import Path


def file_hash(path: str | Path) -> str:
    """Return the SHA-256 of a file, or of a bag folder's files in the order of their names."""
    path = Path(path)
    digest = hashlib.sha256()
    parts = sorted(p for p in path.rglob('*') if p.is_file()) if path.is_dir() else [path]
    for part in parts:
        with part.open('rb') as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()
