"""Files that a URDF names: where meshes, reduced links and outlines are, and surface meshes."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.child_arrays import child_arrays
from denoc_ros.errors import ModelError
from denoc_ros.model.reading.findings import Reader

# Those of robot descriptions that are one file each. Formats of archives and of files that name
# others, such as 3MF and glTF, are left out: a description that has them can be converted.
SURFACE_FORMATS = ('.stl', '.dae', '.obj', '.ply', '.off', '.glb')
MESH_READER = str(Path(__file__).with_name('mesh_reader.py'))


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
        For a file that is no mesh of the formats that are read, or one without triangles.
    """
    found = read_surfaces([file])[file]
    if isinstance(found, ModelError):
        raise found
    return found


def named_surfaces(names: Iterable[str], folder: Path | None) -> dict[str, Any]:
    """Return the meshes of `<mesh filename>`, by name; a name without a file is left out.

    Parameters
    ----------
    folder : path, optional
        As in `mesh_file`. The values are those of `read_surfaces`.
    """
    files = {name: mesh_file(name, folder) for name in names}
    found = read_surfaces(file for file in files.values() if file is not None)
    return {name: found[file] for name, file in files.items() if file is not None}


def read_surfaces(files: Iterable[Path]) -> dict[Path, Any]:
    """Return the meshes of files, each a `trimesh.Trimesh`, or the ModelError that it makes.

    All are read in one process with bounds on memory and time: importing trimesh takes longer
    than reading most meshes.
    """
    found: dict[Path, Any] = {file: _refused(file) for file in files}
    wanted = [file for file, refused in found.items() if refused is None]
    for file, arrays in zip(wanted, child_arrays(MESH_READER, wanted), strict=True):
        found[file] = _surface(file, arrays)
    return found


def _refused(file: Path) -> ModelError | None:
    """Return why a file is not opened: a pipe or a device would never end."""
    if file.suffix.lower() not in SURFACE_FORMATS:
        formats = ', '.join(SURFACE_FORMATS)
        return ModelError(str(file), [f'a surface mesh must be one of {formats}, got another'])
    if not file.is_file():
        got = 'another kind' if file.exists() else 'none'
        return ModelError(str(file), [f'the file must be a regular file, got {got}'])
    return None


def _surface(file: Path, arrays: dict[str, Any] | str) -> Any:
    if isinstance(arrays, str):
        return ModelError(str(file), [f'the file must be a surface mesh, got: {arrays}'])
    vertices, faces = arrays['vertices'], arrays['faces']
    if not len(faces):
        return ModelError(str(file), ['the mesh must have triangles, got none'])
    whole = faces.min() >= 0 and faces.max() < len(vertices) and np.isfinite(vertices).all()
    if not whole:
        return ModelError(str(file), ['the triangles must have finite corners, got others'])
    import trimesh  # here: it takes half a second, and most descriptions need none

    return trimesh.Trimesh(vertices, faces, process=False)
