"""Families of gears: how stiff one of a torque is, and springs proposed for a robot's joints."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from lxml import etree

from denoc_ros.errors import ConfigError
from denoc_ros.model.reading.findings import Element
from denoc_ros.model.reading.rigid_urdf import RigidUrdf, RigidUrdfJoint
from denoc_ros.model.reading.source import written
from denoc_ros.model.tree import JointKind
from denoc_ros.reduction.suggest.suggested_block import appended

ARCMIN = math.pi / 180.0 / 60.0  # rad
# assumed of all: damping = stiffness x this time [s]
DAMPING_TIME = 5e-4
# assumed of all: the peak torque turns the rotor alone, seen from the link, so fast [rad/s^2]
ROTOR_ACCELERATION = 100.0


@dataclass(frozen=True)
class GearFamily:
    """Gears of one kind by size."""

    name: str
    description: str
    torque: tuple[float, ...]  # repeated peak torque at the output [N m], rising
    # torsional stiffness at the output [N m/rad], of the middle of the load range
    stiffness: tuple[float, ...]
    source: str  # where the numbers come from
    spread: float  # factor by which single gears differ from them, either way

    def of_torque(self, torque: float) -> float:
        """Return the stiffness [N m/rad] of a gear for a peak torque [N m].

        A power law between sizes; beyond them stiffness goes with torque.
        """
        sizes, stiffness = np.log(self.torque), np.log(self.stiffness)
        wanted = math.log(torque)
        beyond = wanted - float(np.clip(wanted, sizes[0], sizes[-1]))
        return float(np.exp(np.interp(wanted, sizes, stiffness) + beyond))


GEARS = {
    family.name: family
    for family in (
        GearFamily(
            'strain_wave',
            'strain wave gears (cup type, ratio 80 and more)',
            (36.0, 70.0, 107.0, 204.0, 433.0, 738.0, 1270.0),
            (6.1e3, 1.4e4, 2.5e4, 5.0e4, 1.1e5, 2.0e5, 4.0e5),
            'typical of component sets of sizes 14 to 50, middle torque range, rounded',
            1.5,
        ),
        GearFamily(
            'cycloidal',
            'two-stage cycloidal gears',
            (145.0, 412.0, 1030.0, 1960.0, 3920.0, 7840.0),
            tuple(value / ARCMIN for value in (20.0, 49.0, 108.0, 196.0, 392.0, 980.0)),
            'typical of gears of 58 to 3100 N m rated torque, peak 2.5 times that, rounded',
            1.5,
        ),
        GearFamily(
            'planetary',
            'precision planetary gears, two stages',
            (40.0, 115.0, 290.0, 640.0, 1600.0),
            tuple(value / ARCMIN for value in (3.5, 10.0, 30.0, 70.0, 160.0)),
            'typical of low-backlash gears with 60 to 180 mm flanges, rounded',
            2.0,
        ),
    )
}


@dataclass(frozen=True)
class SpringSuggestion:
    """Proposal of a spring for a joint, and its reasons."""

    joint: str
    effort: float  # N m, of the joint's <limit>
    stiffness: float  # N m/rad
    damping: float  # N m s/rad, assumed
    armature: float | None  # kg m^2, assumed; None: the robot says it


def gear_family(name: str) -> GearFamily:
    """Return a family by name; ConfigError for an unknown one."""
    if name not in GEARS:
        rule = f'gears must be one of {", ".join(GEARS)}, got {name!r}'
        raise ConfigError('suggestion', [rule])
    return GEARS[name]


def suggested_springs(
    robot: RigidUrdf, root: Element, family: GearFamily, looped: Collection[str]
) -> tuple[tuple[SpringSuggestion, ...], dict[str, str]]:
    """Return springs for a robot's joints, and why others get none.

    Parameters
    ----------
    root : lxml element
        `<robot>`: joints that have a `<spring>` keep it, and are in neither answer.
    """
    block = root.find('flexibility')
    elements: list[Element] = [] if block is None else list(block)
    sprung = {e.get('joint') for e in elements if e.tag == 'spring'}
    rotors = {e.get('joint') for e in elements if e.tag == 'actuator'}
    springs, refused = [], dict[str, str]()
    for joint in robot.joints:
        if joint.kind is JointKind.FIXED or joint.name in sprung:
            continue
        why = _unfit(joint, looped)
        if why:
            refused[joint.name] = why
            continue
        effort = joint.limits.effort
        stiffness = family.of_torque(effort)
        rotor = None if joint.name in rotors else effort / ROTOR_ACCELERATION
        springs.append(
            SpringSuggestion(joint.name, effort, stiffness, stiffness * DAMPING_TIME, rotor)
        )
    return tuple(springs), refused


def _unfit(joint: RigidUrdfJoint, looped: Collection[str]) -> str:
    """Return why a joint gets no spring, '' if it does."""
    if joint.kind is not JointKind.REVOLUTE:
        return 'it does not turn: the families are of gears'
    if joint.mimic is not None:
        return 'it is a mimic joint'
    if joint.name in looped:
        return 'a loop closes over it'
    if not 0.0 < joint.limits.effort < math.inf:
        return 'its <limit> has no effort to choose a gear by'
    return ''


def with_springs(
    root: Element, text: str, springs: tuple[SpringSuggestion, ...], family: GearFamily
) -> str:
    """Return a description with springs, and rotors where there are none, added to its block."""
    block = root.find('flexibility')
    if block is None:
        block = appended(root, etree.Element('flexibility'), 0)
    remark = (
        f' Assumed: {family.description}, {family.source}; single gears differ by a factor of '
        f"{family.spread:g}. Use your gears' data sheets. "
    )
    appended(block, etree.Comment(remark), 1)
    for spring in springs:
        numbers = {'stiffness': f'{spring.stiffness:.3g}', 'damping': f'{spring.damping:.2g}'}
        appended(block, etree.Element('spring', joint=spring.joint, **numbers), 1)
        if spring.armature is not None:
            armature = f'{spring.armature:.2g}'
            appended(block, etree.Element('actuator', joint=spring.joint, armature=armature), 1)
    return written(root, text)
