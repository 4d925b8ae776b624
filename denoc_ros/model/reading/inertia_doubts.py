"""Inertias of links that no body of their mass and size has: typing errors, wrong units."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.model.inertia import ROUNDED, difference, from_centre, possible
from denoc_ros.model.reading.findings import Element, Findings
from denoc_ros.model.reading.link_geometry import link_surfaces, outer_box
from denoc_ros.model.reading.rigid_urdf import read_rigid_urdf
from denoc_ros.model.reading.source import TEXT_NAME, parse_xml
from denoc_ros.model.tree import RigidInertia, Tree
from denoc_ros.types import Array


def inertia_doubts(tree: Tree) -> list[str]:
    """Return a warning for each link inertia that no body has; meshes are read.

    That of negative principal moments is among the tree's own warnings.
    """
    root = parse_xml(TEXT_NAME, tree.source)
    bodies = read_rigid_urdf(root, Findings(), []).links
    surfaces = link_surfaces(root, Path(tree.folder) if tree.folder else None)
    found = []
    for link in root.findall('link'):
        name = str(link.get('name'))
        if (body := bodies.get(name)) is not None:
            found += [f'link {name!r}: {doubt}' for doubt in _doubts(link, body, surfaces)]
    return found


def _doubts(link: Element, body: RigidInertia, surfaces: Mapping[str, Any]) -> Iterator[str]:
    if not body.mass > 0.0:
        if np.any(body.inertia):
            yield 'mass of <inertial> should be > 0 where <inertia> is not zero, got 0'
        return
    com = body.first_moment / body.mass
    central = difference(body, from_centre(body.mass, com, np.zeros((3, 3)))).inertia
    low, middle, high = np.linalg.eigvalsh(central).round(18)
    if not possible(central, body.mass * float(com @ com)) and low >= -ROUNDED * high:
        yield (
            'the largest principal moment of <inertia> should be at most the sum of the others, '
            f'got {low:.4g}, {middle:.4g} and {high:.4g} kg m^2: '
            f'{100.0 * (high - middle - low) / high:.3g} % of it is too much'
        )
    if (sides := outer_box(link, surfaces)) is not None:
        yield from _too_wide(np.sqrt(np.maximum(np.diag(central), 0.0) / body.mass), sides)


def _too_wide(radii: Array, sides: Array) -> Iterator[str]:
    """Yield a doubt about the largest excess of radii of gyration (3,) over a box's sides (3,).

    The radius about an axis is at most half the diagonal of the box across it: then half of the
    mass is in each of two opposite edges.
    """
    squares = sides**2
    most = 0.5 * np.sqrt(squares.sum() - squares)
    worst = int(np.argmax(radii - most))
    if radii[worst] > (1.0 + ROUNDED) * most[worst]:
        across = ' x '.join(f'{side:.3g}' for side in np.delete(sides, worst))
        yield (
            f'radius of gyration about {"xyz"[worst]} should be at most {most[worst]:.3g} m, half '
            f'the diagonal of its geometry ({across} m), got {radii[worst]:.3g} m'
        )
