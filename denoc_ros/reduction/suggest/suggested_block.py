"""Write proposed beams into a URDF, the rest of it as it was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from lxml import etree

from denoc_ros.model.reading.findings import Element
from denoc_ros.model.reading.poses import number_text, rpy_of
from denoc_ros.model.reading.source import written
from denoc_ros.reduction.suggest.materials import Material
from denoc_ros.reduction.suggest.slender import SectionNumbers
from denoc_ros.reduction.suggest.suggested_beam import BeamSuggestion

ROUNDED_DOWN = 1.0 - 1e-5  # of the largest mass that a link can give: six digits are written
INDENT = '  '


def with_beams(
    root: Element, text: str, beams: Sequence[BeamSuggestion], material: Material
) -> str:
    """Return a description with beams added to its block.

    Parameters
    ----------
    root : lxml element
        `<robot>`, parsed `whole`; the beams are added in place.
    """
    block = root.find('flexibility')
    if block is None:
        block = appended(root, etree.Element('flexibility'), 0)
    for beam in beams:
        appended(block, etree.Comment(_remark(beam, material)), 1)
        appended(block, _element(beam), 1)
    return written(root, text)


def appended(parent: Element, child: Element, level: int) -> Element:
    """Add a child on a line of its own behind the others."""
    if len(child):
        etree.indent(child, INDENT, level=level + 1)
    before = '\n' + INDENT * (level + 1)
    if len(parent):
        parent[-1].tail = before
    else:
        parent.text = before
    child.tail = '\n' + INDENT * level
    parent.append(child)
    return child


def _remark(beam: BeamSuggestion, material: Material) -> str:
    """Return where the numbers come from; two hyphens may not stand in a comment."""
    stiff, low, high = beam.stiffness, *beam.stiffness.ei_range
    parts = (
        f'{beam.link}: {stiff.section}, {material.name}; {beam.reason}',
        f'EI between {low:.3g} and {high:.3g} N m^2, confidence {stiff.confidence}: {stiff.why}',
        'The damping is assumed',
    )
    return f' {". ".join(parts)}. '.replace('--', '- -')


def _element(beam: BeamSuggestion) -> Element:
    line, stiff, (y, z, torsion) = beam.line, beam.stiffness, beam.modes
    element = etree.Element('beam', link=beam.link, length=number_text(line.length))
    if not stiff.stations:
        element.set('mass_per_length', f'{beam.mass_per_length:.4g}')
    pose = {
        'xyz': number_text(*line.frame[:3, 3]),
        'rpy': number_text(*rpy_of(line.frame[:3, :3])),
    }
    etree.SubElement(element, 'origin', pose)
    ratio = f'{beam.damping_ratio:g}'
    for station in _scaled(beam):
        at = etree.SubElement(element, 'at', x=number_text(station.share * line.length))
        names = ('ei_y', 'ei_z', 'mass_per_length', *(('gj', 'polar_inertia') if torsion else ()))
        for name in names:
            at.set(name, f'{getattr(station, name):.6g}')
    for direction, ei, modes in (('y', stiff.ei_y, y), ('z', stiff.ei_z, z)):
        bending = etree.SubElement(element, 'bending', direction=direction)
        if not stiff.stations:
            bending.set('ei', f'{ei:.4g}')
        bending.set('modes', str(modes))
        bending.set('damping_ratio', ratio)
    if torsion:
        twist = etree.SubElement(element, 'torsion')
        if not stiff.stations:
            twist.set('gj', f'{stiff.gj:.4g}')
            twist.set('polar_inertia', f'{beam.polar_inertia:.4g}')
        twist.set('modes', str(torsion))
        twist.set('damping_ratio', ratio)
    return element


def _scaled(beam: BeamSuggestion) -> list[SectionNumbers]:
    """Return the stations of a taper with the mass and polar inertia that the link can give."""
    stations = beam.stiffness.stations
    shares = [station.share for station in stations]

    def factor(name: str, mean: float) -> float:
        whole = float(np.trapezoid([getattr(s, name) for s in stations], shares))
        return ROUNDED_DOWN * mean / whole if whole else 0.0

    mass = factor('mass_per_length', beam.mass_per_length)
    polar = factor('polar_inertia', beam.polar_inertia)
    return [
        replace(
            station,
            mass_per_length=mass * station.mass_per_length,
            polar_inertia=polar * station.polar_inertia,
        )
        for station in stations
    ]
