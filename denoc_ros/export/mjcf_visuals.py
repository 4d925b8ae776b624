"""Geometry of a robot in MuJoCo's model: drawn rods and visuals, and collision shapes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from lxml import etree
from scipy.spatial.transform import Rotation

from denoc_ros.model.reading.findings import Element, Findings, Reader
from denoc_ros.model.reading.mesh_files import mesh_file
from denoc_ros.model.reading.source import parse_xml
from denoc_ros.model.tree import Beam
from denoc_ros.types import Array

# nothing touches a drawing; collision shapes touch the objects of a scene, not one another
TOUCHING = {'contype': '1', 'conaffinity': '0', 'group': '3'}
DRAWN = {'contype': '0', 'conaffinity': '0', 'group': '2'}
SLENDERNESS = 60.0  # length of a beam per radius of its drawing
MESHES = ('.stl', '.obj', '.msh')


def add_rod(element: Element, beam: Beam, length: float) -> None:
    """Draw a rod of a beam as a capsule."""
    etree.SubElement(
        element,
        'geom',
        type='capsule',
        fromto=_text(0.0, 0.0, 0.0, length, 0.0, 0.0),
        size=_text(beam.whole_length / SLENDERNESS),
        rgba='0.95 0.75 0.3 1',
        **DRAWN,
    )


def add_visuals(
    source: str, places: Mapping[str, tuple[Element, Array]], asset: Element, folder: Path | None
) -> list[str]:
    """Add visuals and collision shapes of rigid links.

    Parameters
    ----------
    places : mapping of str to (element, (4, 4))
        Of each link the body that carries it, and its frame there.
    """
    notes: list[str] = []
    meshes: dict[Path, dict[str, str]] = {}
    for link in parse_xml('visuals', source).findall('link'):
        name = link.get('name')
        if name not in places:
            if link.find('collision') is not None:
                notes.append(f'link {name!r}: a beam touches nothing, its collision is left out')
            continue
        carrier, frame = places[name]
        for visual in [*link.findall('visual'), *link.findall('collision')]:
            origin = visual.find('origin')
            findings = Findings()
            pose = frame
            if origin is not None:
                pose = frame @ Reader(origin, '', findings).pose()
            shape = visual.find('geometry/*')
            drawn = None if shape is None or findings.items else _geometry(shape)
            if shape is not None and shape.tag == 'mesh':
                drawn = _mesh(shape, folder, meshes, asset)
            if drawn is None:
                named = '' if shape is None else shape.get('filename', shape.tag)
                notes.append(f'link {name!r}: {visual.tag} {named!r} is left out')
                continue
            bits = DRAWN if visual.tag == 'visual' else TOUCHING
            etree.SubElement(carrier, 'geom', **drawn, **_placed(pose), **bits)
    return notes


def _geometry(shape: Element) -> dict[str, str] | None:
    """Return a box, cylinder or sphere as a geom; None for another, or one without its sizes."""
    reader = Reader(shape, '', Findings())
    if shape.tag == 'box':
        sizes = 0.5 * reader.numbers('size', 'm')
    elif shape.tag == 'cylinder':
        sizes = np.array([reader.number('radius', 'm'), 0.5 * reader.number('length', 'm')])
    elif shape.tag == 'sphere':
        sizes = np.array([reader.number('radius', 'm')])
    else:
        return None
    if not (len(sizes) and np.isfinite(sizes).all() and (sizes > 0.0).all()):
        return None
    return {'type': shape.tag, 'size': _text(*sizes)}


def _mesh(
    shape: Element, folder: Path | None, meshes: dict[Path, dict[str, str]], asset: Element
) -> dict[str, str] | None:
    """Return a mesh as a geom, None where MuJoCo cannot read its file."""
    found = mesh_file(shape.get('filename', ''), folder)
    if found is None or found.suffix.lower() not in MESHES:
        return None
    if found not in meshes:
        name = f'mesh{len(meshes)}'
        etree.SubElement(
            asset,
            'mesh',
            name=name,
            file=str(found.resolve()),
            scale=shape.get('scale', '1 1 1'),
            inertia='shell',
        )
        meshes[found] = {'type': 'mesh', 'mesh': name}
    return meshes[found]


def _placed(pose: Array) -> dict[str, str]:
    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
    return {'pos': _text(*pose[:3, 3]), 'quat': _text(w, x, y, z)}


def _text(*numbers: float) -> str:
    return ' '.join(f'{number:.9g}' for number in numbers)
