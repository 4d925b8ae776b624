"""Paths of the files that a URDF names: meshes, reduced links, outlines."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from denoc_ros.errors import ModelError
from denoc_ros.model.findings import Reader


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


def named_file(reader: Reader, folder: str) -> Path | None:
    """Return the file of an attribute `file`, None with a finding.

    Parameters
    ----------
    folder : str
        Of the description's file; '' of a text, where it must be an absolute path or a
        `package://` address.
    """
    name = reader.text('file')
    if not name:
        return None
    if not folder and '://' not in name and not Path(name).is_absolute():
        rule = 'be an absolute path or a package:// address where the description is a text'
        reader.fail('file', rule, name)
        return None
    path = mesh_file(name, Path(folder) if folder else None)
    if path is None:
        reader.fail('file', 'be a file, relative to that of the description', name)
    return path


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


def read_surface(file: Path) -> Any:
    """Read a surface mesh, a `trimesh.Trimesh`; the parts of a scene are one mesh.

    Raises
    ------
    ModelError
        For a file that is no mesh, or one without triangles.
    """
    import trimesh  # here: it takes half a second, and most descriptions need none

    try:
        with _silent('trimesh'):
            mesh = trimesh.load(file, force='mesh', skip_materials=True)
    except OSError as error:
        rule = 'the file must be readable'
        raise ModelError(str(file), [f'{rule}, got: {error.strerror or error}']) from error
    except Exception as error:  # a dozen readers, each with errors of its own
        rule = 'the file must be a surface mesh'
        raise ModelError(str(file), [f'{rule}, got: {error or type(error).__name__}']) from error
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise ModelError(str(file), ['the mesh must have triangles, got none'])
    return mesh


@contextmanager
def _silent(*loggers: str) -> Iterator[None]:
    """Keep libraries from reporting errors that are none here."""
    logs = [logging.getLogger(name) for name in loggers]
    levels = [log.level for log in logs]
    for log in logs:
        log.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for log, level in zip(logs, levels, strict=True):
            log.setLevel(level)
