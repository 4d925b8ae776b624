"""The page of `denoc reduce`: mesh, mass, modes, frames, patches, and pictures of the modes."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping
from io import BytesIO
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from denoc_ros.model.beams.link_file import Surface
from denoc_ros.model.tree import RigidInertia
from denoc_ros.pages.html_page import (
    Card,
    PageSection,
    PageTable,
    ReportPage,
    Verdict,
    engineering,
)
from denoc_ros.reduction.reduce_link import ReducedMesh
from denoc_ros.text_table import Row

SWING = 0.12  # of the link's size, in pictures of modes
PICTURES = 6
UNLIKE_MASS = 0.01  # between URDF and mesh: more is told
UNCONVERGED = 0.05  # of the first frequency between two meshes: more is doubtful
SOFT_PATCH = 0.5  # of the energy near a patch: more is told
DPI = 90


def summary(found: ReducedMesh, inertia: RigidInertia | None) -> Row:
    """Return a reduction as plain lists and numbers ready for JSON."""
    reduction = found.reduction
    link = reduction.link
    mass = None if inertia is None or inertia.mass <= 0.0 else float(inertia.mass)
    doubts = list(found.doubts)
    if mass is not None and abs(link.mass / mass - 1.0) > UNLIKE_MASS:
        said = f'the link has {link.mass:.4g} kg, its URDF says {mass:.4g} kg'
        doubts.append(f'{said}: --mass scale takes the URDF’s')
    for name, share in reduction.patch_share.items():
        if share > SOFT_PATCH:
            said = f'{share:.0%} of the strain energy are around the patch of {name or "the root"}'
            doubts.append(f'{said}: a larger radius makes it stiffer')
    coarser = [float(value) for value in found.coarser]
    modes = [
        {'mode': k + 1, 'hz': float(hz), **({'coarser_hz': coarser[k]} if coarser else {})}
        for k, hz in enumerate(link.frequencies)
    ]
    shares = {name: 100.0 * share for name, share in reduction.patch_share.items()}
    off = abs(coarser[0] / link.frequencies[0] - 1.0) if coarser else 0.0
    return {
        'source': link.source,
        'mass_kg': link.mass,
        'urdf_mass_kg': mass,
        'com_m': link.com.tolist(),
        'inertia_kg_m2': link.inertia.tolist(),
        'nodes': reduction.nodes,
        'coarser_nodes': found.coarser_nodes,
        'points': len(link.points),
        'quadratic': reduction.quadratic,
        'quadratic_terms': len(link.pairs),
        'frequencies_hz': link.frequencies.tolist(),
        'left_out_hz': link.frequencies_left_out.tolist(),
        'static_columns': list(reduction.static),
        'modes': modes,
        'frames': [
            {
                'frame': name,
                'along': 'xyz'[axis],
                'm_per_n': float(values[axis]),
                'lacking_percent': float(link.left_out[name][axis]),
            }
            for name, values in reduction.compliance.items()
            for axis in range(3)
        ],
        'patches': [
            {
                'frame': patch.name or 'root',
                'radius_m': patch.radius,
                'nodes': len(patch.nodes),
                'energy_percent': shares.get(patch.name),
            }
            for patch in reduction.patches
        ],
        'doubts': doubts,
        'doubtful': bool(off > UNCONVERGED),
    }


def page(found: ReducedMesh, row: Row, name: str, provenance: Mapping[str, str]) -> ReportPage:
    """Return the page."""
    link = found.reduction.link
    return ReportPage(
        title='A link from finite elements',
        subtitle=f'{name} · {link.source}',
        verdict=_verdict(row),
        cards=_cards(row),
        sections=[
            _modes(row),
            None if link.surface is None else _pictures(link.surface, link.frequencies),
            _frames(row),
            _patches(row),
            _doubts(row),
        ],
        provenance=provenance,
    )


def _verdict(row: Row) -> Verdict:
    first = engineering(row['frequencies_hz'][0], 'Hz')
    text = f'{len(row["modes"])} modes from {first} on stand for {row["nodes"]} nodes.'
    if row['coarser_nodes']:
        off = row['modes'][0]['coarser_hz'] / row['modes'][0]['hz'] - 1.0
        nodes = row['coarser_nodes']
        text += f' On a mesh of {nodes} nodes the first frequency is {off:+.2%} off.'
    return Verdict(text, 'doubtful' if row['doubtful'] else 'good')


def _cards(row: Row) -> list[Card]:
    said = row['urdf_mass_kg']
    note = '' if said is None else f'URDF: {said:.4g} kg'
    worst = max(each['lacking_percent'] for each in row['frames'])
    return [
        Card('Mass', f'{row["mass_kg"]:.4g} kg', note),
        Card('First frequency', engineering(row['frequencies_hz'][0], 'Hz'), 'root clamped'),
        Card('Points', str(row['points']), 'that stand for all integrals'),
        Card('Static compliance lacking', f'{worst:.2g} %', 'of the worst direction at a frame'),
    ]


def _modes(row: Row) -> PageSection:
    head = ['mode', 'frequency', 'coarser mesh', 'difference']
    rows = []
    for mode in row['modes']:
        cells = [str(mode['mode']), engineering(mode['hz'], 'Hz')]
        if 'coarser_hz' in mode:
            off = mode['coarser_hz'] / mode['hz'] - 1.0
            cells += [engineering(mode['coarser_hz'], 'Hz'), f'{off:+.2%}']
        rows.append(cells + ['–'] * (4 - len(cells)))
    left = ', '.join(engineering(value, 'Hz') for value in row['left_out_hz'])
    columns = ', '.join(row['static_columns']) or 'none'
    text = (
        'The root is clamped, all other frames are free. Left out: '
        f'{left or "nothing"} and above. Forces with a static column of their own: {columns}; '
        'the highest modes stand for them.'
    )
    return PageSection('Modes', text, tables=[PageTable(head, rows)])


def _frames(row: Row) -> PageSection:
    rows = [
        [
            f'{f["frame"]}, {f["along"]}',
            engineering(f['m_per_n'], 'm/N'),
            f'{f["lacking_percent"]:.2g} %',
        ]
        for f in row['frames']
    ]
    text = 'Displacement of each frame under a unit force, and what the modes lack of it.'
    table = PageTable(['frame', 'compliance', 'lacking'], rows)
    return PageSection('Static compliance', text, tables=[table])


def _patches(row: Row) -> PageSection:
    rows = [
        [
            patch['frame'],
            engineering(patch['radius_m'], 'm'),
            str(patch['nodes']),
            '–' if patch['energy_percent'] is None else f'{patch["energy_percent"]:.3g} %',
        ]
        for patch in row['patches']
    ]
    text = (
        'Nodes of a patch move as one rigid body with the frame. A patch that is too small'
        ' softens its joint: the last column is the share of the strain energy within two radii,'
        ' under a force at the last frame in the worst direction.'
    )
    head = ['frame', 'radius', 'nodes', 'energy around it']
    return PageSection('Rigid patches', text, tables=[PageTable(head, rows)])


def _doubts(row: Row) -> PageSection | None:
    if not row['doubts']:
        return None
    table = PageTable(['warning'], [[doubt] for doubt in row['doubts']])
    return PageSection('To consider', 'The link is usable; these may matter.', tables=[table])


def _pictures(surface: Surface, frequencies: Any) -> PageSection:
    """Return a section with each mode's shape, coloured by its displacement."""
    pictures = []
    for k, hz in enumerate(frequencies[:PICTURES]):
        shown = f'mode {k + 1}, {engineering(hz, "Hz")}'
        pictures.append(f'<img alt="{shown}" src="data:image/png;base64,{_png(surface, k)}">')
    text = 'The first modes in their order, far enlarged; the colour is the displacement.'
    return PageSection('Shapes of the modes', text, picture=Markup(''.join(pictures)))


def _png(surface: Surface, mode: int) -> str:
    """Return a picture of a mode as base64."""
    phi = surface.phi[:, :, mode]
    size = float(np.ptp(surface.nodes, axis=0).max())
    moved = np.linalg.norm(phi, axis=1)
    corners = (surface.nodes + SWING * size / moved.max() * phi)[surface.faces]
    canvas = Figure(figsize=(4.4, 3.0), layout='constrained')
    FigureCanvasAgg(canvas)
    axes: Any = canvas.add_subplot(projection='3d')
    colours = colormaps['viridis'](moved[surface.faces].mean(axis=1) / moved.max())
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-30)[:, None]
    colours[:, :3] *= (0.7 + 0.3 * np.abs(normals @ np.array([0.3, -0.5, 0.81])))[:, None]
    axes.add_collection3d(Poly3DCollection(corners, facecolors=np.clip(colours, 0.0, 1.0)))
    low, high = corners.reshape(-1, 3).min(axis=0), corners.reshape(-1, 3).max(axis=0)
    extent = np.maximum(high - low, 0.15 * size)
    middle = 0.5 * (low + high)
    axes.set(
        xlim=middle[0] + 0.5 * extent[0] * np.array([-1, 1]),
        ylim=middle[1] + 0.5 * extent[1] * np.array([-1, 1]),
        zlim=middle[2] + 0.5 * extent[2] * np.array([-1, 1]),
    )
    axes.set_box_aspect(extent)
    axes.set_axis_off()
    file = BytesIO()
    canvas.savefig(file, dpi=DPI, format='png', transparent=True)
    return b64encode(file.getvalue()).decode()
