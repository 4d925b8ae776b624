"""Propose a `<flexibility>` block for a plain URDF: links that bend enough, with numbers."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from denoc_ros.errors import ConfigError, ModelError
from denoc_ros.model.link_side import looped_joints
from denoc_ros.model.reading.findings import Element, Findings
from denoc_ros.model.reading.link_geometry import link_surfaces
from denoc_ros.model.reading.rigid_urdf import read_rigid_urdf
from denoc_ros.model.reading.source import TEXT_NAME, parse_xml, read_source
from denoc_ros.model.reading.urdf import tree_of
from denoc_ros.reduction.suggest.carried_bodies import SubtreeInertia, link_loads
from denoc_ros.reduction.suggest.gears import (
    GearFamily,
    SpringSuggestion,
    gear_family,
    suggested_springs,
    with_springs,
)
from denoc_ros.reduction.suggest.materials import MATERIALS, Material
from denoc_ros.reduction.suggest.suggested_beam import BeamSuggestion, Wish, suggested_beam
from denoc_ros.reduction.suggest.suggested_block import with_beams


@dataclass(frozen=True)
class Suggestion:
    """A robot with the links that are worth it made flexible."""

    material: Material  # what all proposed links are taken to be made of
    # every moving link that could be a beam, in file order, worth it or not
    beams: tuple[BeamSuggestion, ...]
    refused: dict[str, str]  # moving links that cannot be one, and why
    text: str  # the URDF with the block; the unchanged one where no link is worth it
    # what gears the joints are taken to have, where that was asked for
    gears: GearFamily | None = None
    springs: tuple[SpringSuggestion, ...] = ()  # springs proposed for joints
    # joints without a spring for which none is proposed, and why
    stiff: dict[str, str] = field(default_factory=dict)


def suggest_flexibility(
    source: str | os.PathLike[str],
    material: str = 'aluminium',
    links: Sequence[str] | None = None,
    bandwidth: float = 10.0,
    gravity: float = 9.81,
    gears: str | None = None,
) -> Suggestion:
    """Propose beams for a robot's links from their inertia, joints, geometry and a material.

    Parameters
    ----------
    source : str or path
        A URDF, or its text; links that have a `<beam>` keep it.
    material : str
        One of `denoc_ros.reduction.suggest.materials.MATERIALS`.
    links : sequence of str, optional
        Make these flexible, worth it or not; default: those that are worth it.
    bandwidth : float
        Of the robot's control [Hz]: a link is worth it if its first frequency is below five
        times this, or if it bends by a thousandth of its length under the load that it carries
        or its joint's effort; modes are kept up to ten times this.
    gravity : float
        Its size where the robot works [m/s^2]; 0 in space.
    gears : str, optional
        Propose springs for the joints as well: one of the `GEARS` of
        :mod:`denoc_ros.reduction.suggest.gears`. The stiffness follows from the effort of
        a joint's limit, and is an assumption.

    Returns
    -------
    Suggestion
        The proposal with its reasons, and the URDF with it.

    Raises
    ------
    ModelError
        With every finding of the file, or for links that cannot be beams.
    ConfigError
        For unknown gears, an unknown material or link, a bad bandwidth or gravity.
    """
    _check_wishes(material, bandwidth, gravity)
    family = None if gears is None else gear_family(gears)
    where, text = read_source(source)
    root = parse_xml(where, text, whole=True)
    tree = tree_of(parse_xml(where, text), where, text)  # a bad file is to be mended first
    robot = read_rigid_urdf(root, Findings(), [])
    loads = link_loads(robot)
    _check_links(where, links, loads, root)
    wish = Wish(
        MATERIALS[material],
        bandwidth,
        gravity,
        link_surfaces(root, Path() if where == TEXT_NAME else Path(where).resolve().parent),
    )
    beams, refused = [], dict[str, str]()
    for element in root.findall('link'):
        link, load = element.get('name', ''), loads[element.get('name', '')]
        asked = links is not None and link in links
        if not asked and (load.joint is None or links is not None or _has_beam(root, link)):
            continue
        found = suggested_beam(link, load, element, wish, asked)
        if isinstance(found, str):
            refused[link] = found
        else:
            beams.append(found)
    hopeless = [f'link {link!r}: {refused[link]}' for link in links or () if link in refused]
    if hopeless:
        raise ModelError(where, hopeless)
    worth = [beam for beam in beams if beam.worth]
    suggested = with_beams(root, text, worth, MATERIALS[material]) if worth else text
    springs: tuple[SpringSuggestion, ...] = ()
    stiff: dict[str, str] = {}
    if family is not None:
        springs, stiff = suggested_springs(robot, root, family, looped_joints(tree))
        suggested = with_springs(root, suggested, springs, family) if springs else suggested
    tree_of(parse_xml(where, suggested), where, suggested)
    return Suggestion(
        MATERIALS[material], tuple(beams), refused, suggested, family, springs, stiff
    )


def _check_wishes(material: str, bandwidth: float, gravity: float) -> None:
    findings = []
    if material not in MATERIALS:
        findings.append(f'material must be one of {", ".join(MATERIALS)}, got {material!r}')
    if not 0.0 < bandwidth < math.inf:
        findings.append(f'bandwidth must be > 0 Hz and finite, got {bandwidth:g}')
    if not 0.0 <= gravity < math.inf:
        findings.append(f'gravity must be >= 0 m/s^2 and finite, got {gravity:g}')
    ConfigError.raise_any('suggestion', findings)


def _check_links(
    where: str, links: Sequence[str] | None, loads: Mapping[str, SubtreeInertia], root: Element
) -> None:
    known = ', '.join(loads)
    findings = [
        f'link must be one of {known}, got {link!r}' for link in links or () if link not in loads
    ]
    findings += [
        f'link {link!r} must have no <beam> yet, got one'
        for link in links or ()
        if _has_beam(root, link)
    ]
    ConfigError.raise_any(where, findings)


def _has_beam(root: Element, link: str) -> bool:
    described = (*root.iterfind('flexibility/beam'), *root.iterfind('flexibility/flexible'))
    return any(element.get('link') == link for element in described)
