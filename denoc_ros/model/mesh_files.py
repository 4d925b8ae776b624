"""Paths of the mesh files that a URDF names."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path


def mesh_file(name: str, folder: Path | None) -> Path | None:
    """Return the file of a mesh's name, None where there is none; nothing is fetched.

    Parameters
    ----------
    name : str
        As in `<mesh filename>`: a path, or a `package://` or `file://` address.
    folder : path, optional
        Of the URDF. A package is looked for in the prefixes of AMENT_PREFIX_PATH and above the
        folder, with and without its name: descriptions are moved about without their package.
    """
    return next((path for path in _candidates(name, folder) if path.is_file()), None)


def _candidates(name: str, folder: Path | None) -> Iterator[Path]:
    scheme, colon, rest = name.rpartition('://')
    if scheme == 'package':
        prefixes = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
        yield from (Path(prefix, 'share', rest) for prefix in prefixes if prefix)
        if folder is not None:
            here = folder.resolve()
            for above in (here, *here.parents):
                yield above / rest
                yield above / rest.partition('/')[2]
    elif not colon or scheme == 'file':
        yield Path(folder or '', rest)
