"""Numbers of a cross-section of any outline, by finite elements: sectionproperties."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from sectionproperties.analysis.section import Section
from sectionproperties.pre.geometry import Geometry
from shapely import Polygon
from shapely.ops import unary_union

from denoc_ros.child_arrays import child_arrays
from denoc_ros.errors import ModelError
from denoc_ros.model.beams.cross_sections import CrossSection, SectionAxes
from denoc_ros.model.reading.mesh_files import MESH_READER
from denoc_ros.types import Array

FORMATS = ('.dxf', '.csv')
THROUGH_WALL = 2.0  # triangles of six nodes through a wall of the mean thickness
TRIANGLES = 1500  # at least
ALIKE = 1e-6  # of a moment: as many, and the principal axes are any
SAME_POINT = 1e-4  # of the section's size: mesh noise between centroid and shear centre

Loop = tuple[tuple[float, float], ...]  # corners y, z [m]


def read_outline(file: Path, scale: float) -> tuple[Loop, ...]:
    """Return the closed lines of a file, outer ones and holes, in metres.

    Parameters
    ----------
    file : Path
        `.dxf`; or `.csv`, a line `y,z` per corner and an empty line between closed lines.
    scale : float
        Metres per unit of the file.

    Raises
    ------
    ModelError
        For a file that has no closed lines.
    """
    where, suffix = str(file), file.suffix.lower()
    if suffix not in FORMATS:
        raise ModelError(where, [f'file must end in {" or ".join(FORMATS)}, got {file.name!r}'])
    try:
        lines = _dxf(file) if suffix == '.dxf' else _csv(file)
        loops = [scale * np.asarray(line, dtype=np.float64)[:, :2] for line in lines]
    except Exception as error:  # torn files end in errors of many kinds
        got = str(error) or type(error).__name__
        raise ModelError(where, [f'file must be an outline of y and z, got: {got}']) from error
    if not loops or not all(np.isfinite(loop).all() and len(loop) > 2 for loop in loops):
        rule = 'file must have closed lines of three corners or more, finite'
        raise ModelError(where, [f'{rule}, got {len(loops)} lines'])
    return tuple(tuple((float(y), float(z)) for y, z in loop) for loop in loops)


def _dxf(file: Path) -> list[Array]:
    (found,) = child_arrays(MESH_READER, [file])
    if isinstance(found, str):
        raise ValueError(found)
    ends = np.cumsum(found['counts'])
    return np.split(found['corners'], ends[:-1]) if len(ends) else []


def _csv(file: Path) -> list[list[list[float]]]:
    blocks: list[list[list[float]]] = [[]]
    for line in file.read_text(encoding='utf-8').splitlines():
        if line.lstrip().startswith('#'):
            continue
        if line.strip(' ,;\t'):
            blocks[-1].append([float(part) for part in line.replace(';', ',').split(',')])
        elif blocks[-1]:
            blocks.append([])
    return [block for block in blocks if block]


@lru_cache(maxsize=256)
def profile_section(loops: tuple[Loop, ...]) -> CrossSection:
    """Return the numbers of an outline.

    Parameters
    ----------
    loops : tuple of closed lines
        A line inside another is a hole.

    Raises
    ------
    ModelError
        For lines that cross or leave several pieces.

    Notes
    -----
    Torsion constant, shear centre and warping constant are those of St-Venant's and Vlasov's
    theory for Poisson's ratio 0.
    """
    outline = _outline(loops)
    edge = 2.0 * outline.area / outline.length / THROUGH_WALL
    geometry = Geometry(outline)
    geometry.create_mesh(mesh_sizes=[min(0.5 * edge**2, outline.area / TRIANGLES)])
    section: Any = Section(geometry)
    section.calculate_geometric_properties()
    section.calculate_warping_properties()
    along_z, along_y, mixed = (float(value) for value in section.get_ic())
    turn, moments = _principal(along_y, along_z, mixed)
    centre = np.array(section.get_c(), dtype=np.float64)
    shear = np.array(section.get_sc(), dtype=np.float64)
    if np.linalg.norm(shear - centre) < SAME_POINT * math.sqrt(outline.area):
        shear = centre
    axes = SectionAxes.of(turn, *(float(value) for value in (*centre, *shear)))
    cos, sin = math.cos(turn), math.sin(turn)
    corners = (np.concatenate([np.array(loop) for loop in loops]) - centre) @ [
        [cos, -sin],
        [sin, cos],
    ]
    fibre = np.abs(corners).max(axis=0)
    return CrossSection(
        float(outline.area),
        *moments,
        float(section.get_j()),
        axes,
        float(section.get_gamma()),
        (float(fibre[0]), float(fibre[1])),
    )


def _principal(along_y: float, along_z: float, mixed: float) -> tuple[float, tuple[float, float]]:
    """Return the turn [rad], at most 45 degrees, and moments along the principal axes."""
    mean, half = 0.5 * (along_y + along_z), 0.5 * (along_y - along_z)
    spread = math.hypot(half, mixed)
    if spread < ALIKE * mean:
        return 0.0, (mean, mean)
    turn = 0.5 * math.atan2(mixed, half)
    if abs(turn) <= 0.25 * math.pi * (1.0 + 1e-9):
        return turn, (mean + spread, mean - spread)
    return turn - math.copysign(0.5 * math.pi, turn), (mean - spread, mean + spread)


def _outline(loops: Iterable[Loop]) -> Any:
    """Return the polygon of closed lines, each inside an odd number of others a hole."""
    polygons = sorted((Polygon(loop) for loop in loops), key=lambda each: -each.area)
    findings = [
        f'each closed line must not cross itself, got {len(each.exterior.coords) - 1} corners'
        for each in polygons
        if not each.is_valid or each.area <= 0.0
    ]
    ModelError.raise_any('section', findings)
    solids: Any = Polygon()
    for each in polygons:
        inside = solids.contains(each)
        crossing = not inside and solids.intersection(each).area > 0.0
        if crossing:
            raise ModelError(
                'section', ['closed lines must not cross each other, got two that do']
            )
        solids = solids.difference(each) if inside else unary_union([solids, each])
    if solids.geom_type != 'Polygon':
        got = len(solids.geoms)
        raise ModelError('section', [f'the section must be one piece, got {got}'])
    return solids
