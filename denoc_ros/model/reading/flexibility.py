"""The `<flexibility>` block: its elements, read and validated one by one."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from denoc_ros.model.beams.along import CONSTANT, Along
from denoc_ros.model.beams.beam_sections import (
    NO_LIMIT,
    STRAINS,
    BeamSection,
    Profile,
    StrainLimit,
    at_most_one,
    read_section,
    read_stations,
    read_strain_limit,
)
from denoc_ros.model.beams.component_links import FlexibleElement, read_flexible
from denoc_ros.model.beams.cross_sections import SectionAxes
from denoc_ros.model.beams.shapes import SHAPES
from denoc_ros.model.payloads import moving_links, read_payload
from denoc_ros.model.reading.findings import Element, Findings, Reader
from denoc_ros.model.reading.rigid_urdf import RigidUrdf
from denoc_ros.model.sensors import read_inertial_sensor, read_sensor
from denoc_ros.model.tree import (
    INERTIAL_SENSORS,
    SIDES,
    InertialElement,
    JointKind,
    Payload,
    SensorElement,
    Spring,
)
from denoc_ros.types import Array

MOST_MODES = 50  # more would only be a typing error
ELEMENTS = ('beam', 'flexible', 'loop', 'sensor', 'actuator', 'spring', 'payload')
MOST_SEGMENTS = 200


@dataclass(frozen=True)
class DeformationElement:
    """`<bending>` or `<torsion>` as the file says it."""

    stiffness: float  # EI [N m^2] or GJ [N m^2]: the mean over the length
    modes: int
    damping_ratio: Array | None  # (modes,) or (1,)
    damping: Array | None  # (modes,) or (1,)
    along: Along = CONSTANT  # shares of the stiffness, which is the mean


@dataclass(frozen=True)
class BeamElement:
    """`<beam>` as the file says it; a section is resolved to numbers."""

    link: str
    origin: Array  # (4, 4) beam frame seen from the link frame
    length: float
    mass_per_length: float | None  # None: the link's mass / length
    polar_inertia: float | None  # None: the link's inertia about the beam axis / length
    shape: str  # '' as the load on the beam asks for, see `shape_for`
    y: DeformationElement | None
    z: DeformationElement | None
    torsion: DeformationElement | None
    segments: int = 1  # equal beams that it is divided into
    mass_along: Along = CONSTANT  # shares of mass_per_length, which is the mean
    polar_along: Along = CONSTANT  # shares of polar_inertia, which is the mean
    strain: StrainLimit = NO_LIMIT
    axes: SectionAxes | None = None  # where sections that are not on the axis lie
    stretch: Profile | None = None  # EA [N]
    warping_rigidity: float = 0.0  # E Gamma [N m^4], the largest; 0 where it is not known


@dataclass
class Flexibility:
    """The whole block: only elements without findings, in file order."""

    beams: dict[str, BeamElement] = field(default_factory=dict)  # by link
    components: dict[str, FlexibleElement] = field(default_factory=dict)  # by link
    loops: list[LoopElement] = field(default_factory=list)
    sensors: list[SensorElement] = field(default_factory=list)
    inertial_sensors: list[InertialElement] = field(default_factory=list)
    armatures: dict[str, float] = field(default_factory=dict)  # by joint
    springs: dict[str, Spring] = field(default_factory=dict)  # by joint
    payloads: dict[str, Payload] = field(default_factory=dict)  # by link
    flexible_links: set[str] = field(default_factory=set)  # beams with findings as well
    component_names: set[str] = field(default_factory=set)  # likewise of <flexible>


def read_flexibility(root: Element, findings: Findings, folder: str = '') -> Flexibility:
    """Return the elements of the `<flexibility>` block.

    Parameters
    ----------
    folder : str
        Of the description's file, '' of a text.
    """
    blocks = root.findall('flexibility')
    if len(blocks) > 1:
        findings.add('flexibility', f'block must occur once, got {len(blocks)}')
    for child in root.iterchildren('{*}*'):
        if child.tag != 'flexibility' and child.tag.lower() == 'flexibility':
            findings.add('flexibility', f'block must be called <flexibility>, got <{child.tag}>')
    flexibility = Flexibility()
    links = {link.get('name') for link in root.findall('link')}
    for block in blocks:
        Reader(block, 'flexibility', findings).only((), ELEMENTS)
        for element in block.findall('beam'):
            _add_beam(element, links, flexibility, folder, findings)
        for element in block.findall('flexible'):
            _add_component_link(element, links, flexibility, folder, findings)
        for element in block.findall('actuator'):
            _add_actuator(element, root, flexibility, findings)
        for element in block.findall('spring'):
            joint, spring = read_spring(element, root, flexibility.springs, findings)
            flexibility.springs[joint] = spring
        moving = moving_links(root)
        for element in block.findall('payload'):
            read_payload(element, links, moving, flexibility.payloads, findings)
        _add_loops(block, links, flexibility, findings)
        _add_sensors(block, links, flexibility, findings)
    return flexibility


def _add_loops(
    block: Element, links: set[str], flexibility: Flexibility, findings: Findings
) -> None:
    names: set[str] = set()
    for element in block.findall('loop'):
        loop = read_loop(element, links, names, findings)
        if loop is not None:
            flexibility.loops.append(loop)


def _add_sensors(
    block: Element, links: Collection[str], flexibility: Flexibility, findings: Findings
) -> None:
    names: set[str] = set()
    flexible = flexibility.flexible_links
    values = 0  # of the sensors so far
    for element in block.findall('sensor'):
        if element.get('type') in INERTIAL_SENSORS:
            inertial = read_inertial_sensor(element, links, flexible, names, values, findings)
            if inertial is not None:
                flexibility.inertial_sensors.append(inertial)
                values += len(inertial.parts)
            continue
        sensor = read_sensor(element, flexible, flexibility.component_names, names, findings)
        if sensor is not None:
            flexibility.sensors.append(sensor)
            values += 1


def _add_component_link(
    element: Element, links: set[str], flexibility: Flexibility, folder: str, findings: Findings
) -> None:
    link = element.get('link', '')
    if link in flexibility.flexible_links | flexibility.component_names:
        findings.add(f'flexible {link!r}', 'link must have one <beam> or <flexible>, got two')
    flexibility.component_names.add(link)
    found = read_flexible(element, links, folder, findings)
    if found is not None:
        flexibility.components[link] = found


def _add_actuator(
    element: Element, root: Element, flexibility: Flexibility, findings: Findings
) -> None:
    name = element.get('joint', '')
    reader = Reader(element, f'actuator of joint {name!r}', findings)
    reader.only(('joint', 'armature'))
    movable = {
        joint.get('name')
        for joint in root.findall('joint')
        if joint.get('type') not in ('fixed', 'floating')
    }
    if reader.text('joint') and name not in movable:
        reader.fail('joint', 'be a movable joint of the robot', name)
    if name in flexibility.armatures:
        findings.add(reader.whose, 'must occur once, got it twice')
    flexibility.armatures[name] = reader.number('armature', 'kg m^2 or kg', least=0.0)


def _add_beam(
    element: Element, links: set[str], flexibility: Flexibility, folder: str, findings: Findings
) -> None:
    before, link = len(findings.items), element.get('link', '')
    reader = Reader(element, f'beam {link!r}', findings)
    reader.only(
        ('link', 'length', 'mass_per_length', 'shape', 'segments', 'interpolation', *STRAINS),
        ('origin', 'section', 'material', 'at', 'bending', 'torsion'),
    )
    if reader.text('link') and link not in links:
        reader.fail('link', 'be a link of the robot', link)
    if link in flexibility.flexible_links:
        findings.add(reader.whose, 'link must have one beam, got two')
    flexibility.flexible_links.add(link)
    beam = _read_beam(reader, link, folder)
    if len(findings.items) == before:
        flexibility.beams[link] = beam


def _read_beam(reader: Reader, link: str, folder: str) -> BeamElement:
    section = read_section(reader, folder=folder)
    length = reader.number('length', 'm', above=0.0)
    along = read_stations(reader, length, folder)
    stations, axes, warping = along.profiles, along.axes, along.warping_rigidity
    if section is not None:
        axes, warping = section.section.axes, section.warping_rigidity
    origin = _read_origin(reader)
    if axes is not None and axes.straight:  # a beam along the principal axes
        origin, axes = origin @ axes.pose, None
    mass_per_length = None if section is None else section.mass_per_length
    if 'mass_per_length' in stations:
        mass_per_length = stations['mass_per_length'][0]
    if reader.element.get('mass_per_length') is not None:
        given = reader.number('mass_per_length', 'kg/m', above=0.0)
        if section is not None:
            reader.fail('mass_per_length', 'not come with a <section>', given)
        mass_per_length = given
    segments = _read_segments(reader)
    shape = _read_shape(reader, segments)
    bending = _read_bendings(reader, section, stations, shape, segments)
    torsion, polar_inertia = _read_torsion(reader, section, stations, segments)
    return BeamElement(
        link,
        origin,
        length,
        mass_per_length,
        polar_inertia,
        shape,
        bending.get('y'),
        bending.get('z'),
        torsion,
        segments,
        mass_along=stations.get('mass_per_length', (0.0, CONSTANT))[1],
        polar_along=stations.get('polar_inertia', (0.0, CONSTANT))[1],
        strain=read_strain_limit(reader, section),
        axes=axes,
        stretch=stations.get('ea'),
        warping_rigidity=warping,
    )


def _read_segments(reader: Reader) -> int:
    if reader.element.get('segments') is None:
        return 1
    segments = reader.count('segments', MOST_SEGMENTS, 1)
    deforms = any(reader.element.find(tag) is not None for tag in ('bending', 'torsion'))
    if segments > 1 and not deforms:
        reader.fail('segments', 'be 1 without a <bending> or <torsion>', segments)
    return segments


def _read_shape(reader: Reader, segments: int) -> str:
    """Return the shape; segments need one that hands the load at its tip on."""
    if segments == 1:
        given = reader.element.get('shape') is not None
        return reader.choice('shape', SHAPES) if given else ''
    shape = reader.choice('shape', SHAPES, 'craig-bampton')
    if shape not in ('', 'craig-bampton'):
        reader.fail('shape', 'be craig-bampton (the default) with segments > 1', shape)
    return shape


def _read_origin(reader: Reader) -> Array:
    found = at_most_one(reader, 'origin')
    if found is None:
        return np.eye(4)
    origin = Reader(found, reader.whose, reader.findings, ' of <origin>')
    origin.only(('xyz', 'rpy'))
    return origin.pose()


def _read_bendings(
    reader: Reader,
    section: BeamSection | None,
    stations: Mapping[str, Profile],
    shape: str,
    segments: int,
) -> dict[str, DeformationElement]:
    found: dict[str, DeformationElement] = {}
    for element in reader.element.findall('bending'):
        direction = element.get('direction', '')
        bending = Reader(element, reader.whose, reader.findings, f' (direction {direction})')
        bending.only(('direction', 'ei', 'modes', 'damping_ratio', 'damping'))
        Reader(element, f'{reader.whose} <bending>', reader.findings).choice(
            'direction', ('y', 'z')
        )
        if direction in found:
            bending.fail('direction', 'occur once', direction)
        stiffness = None if section is None else section.flexural_rigidity(direction)
        found[direction] = _read_deformation(
            bending, 'ei', stiffness, stations.get(f'ei_{direction}'), 'N s/m', segments
        )
        if shape == 'craig-bampton' and segments == 1 and found[direction].modes == 1:
            bending.fail('modes', 'be >= 2 with shape craig-bampton', 1)
    return found


def _read_torsion(
    reader: Reader, section: BeamSection | None, stations: Mapping[str, Profile], segments: int
) -> tuple[DeformationElement | None, float | None]:
    """Return the deformation and the polar inertia per length, None where not given."""
    element = at_most_one(reader, 'torsion')
    polar_inertia = None if section is None else section.polar_inertia
    if 'polar_inertia' in stations:
        polar_inertia = stations['polar_inertia'][0]
    if element is None:
        return None, polar_inertia
    torsion = Reader(element, reader.whose, reader.findings, ' (torsion)')
    torsion.only(('gj', 'polar_inertia', 'modes', 'damping_ratio', 'damping'))
    if element.get('polar_inertia') is not None:
        given = torsion.number('polar_inertia', 'kg m^2/m', above=0.0)
        if section is not None:
            torsion.fail('polar_inertia', 'not come with a <section>', given)
        polar_inertia = given
    stiffness = None if section is None else section.torsional_rigidity
    read = _read_deformation(torsion, 'gj', stiffness, stations.get('gj'), 'N m s/rad', segments)
    return read, polar_inertia


def _read_deformation(
    reader: Reader,
    name: str,
    stiffness: float | None,
    profile: Profile | None,
    damping_unit: str,
    segments: int,
) -> DeformationElement:
    along = CONSTANT
    if profile is not None:
        stiffness, along = profile
        if reader.element.get(name) is not None:  # the same shares of another mean
            stiffness = reader.number(name, 'N m^2', above=0.0)
    elif stiffness is None:
        stiffness = reader.number(name, 'N m^2', above=0.0)
    elif reader.element.get(name) is not None:
        reader.fail(name, 'not come with a <section>', reader.element.get(name))
    modes = reader.count('modes', MOST_MODES)
    ratio = _read_damping(reader, 'damping_ratio', '-', modes)
    damping = _read_damping(reader, 'damping', damping_unit, modes)
    if ratio is not None and damping is not None:
        reader.fail('damping', 'not come with damping_ratio', reader.element.get('damping'))
    if segments > 1 and ratio is not None and len(ratio) > 1:
        rule = "be one number with segments > 1: the ratio of the link's first mode"
        reader.fail('damping_ratio', rule, reader.element.get('damping_ratio'))
    return DeformationElement(stiffness, modes, ratio, damping, along)


def _read_damping(reader: Reader, name: str, unit: str, modes: int) -> Array | None:
    text = reader.element.get(name)
    if text is None:
        return None
    values = reader.numbers(name, unit, least=0.0)
    if len(values) not in (0, 1, modes):
        reader.fail(name, f'have one number, or one for each of {modes} modes', text)
    return values


# loops ------------------------------------------------------------------------------------------

WITH_AXIS = ('revolute', 'prismatic', 'universal')
WITH_DYNAMICS = ('revolute', 'prismatic')
TYPES = (*WITH_AXIS, 'spherical', 'fixed')


@dataclass(frozen=True)
class LoopElement:
    """`<loop>` as the file says it."""

    name: str
    type: str
    parent: str  # link
    parent_origin: Array  # (4, 4) loop frame seen from the link frame
    child: str
    child_origin: Array  # (4, 4)
    axis: Array | None  # (3,) unit
    axis2: Array | None  # (3,) unit
    damping: float
    friction: float


def read_loop(
    element: Element, links: Collection[str], names: set[str], findings: Findings
) -> LoopElement | None:
    """Return a loop, None if it has findings."""
    before, name = len(findings.items), element.get('name', '')
    reader = Reader(element, f'loop {name!r}', findings)
    reader.only(('name', 'type'), ('parent', 'child', 'axis', 'axis2', 'dynamics'))
    reader.unique_name(names)
    type_ = reader.choice('type', TYPES)
    parent, parent_origin = _read_end(reader, 'parent', links)
    child, child_origin = _read_end(reader, 'child', links)
    if parent and parent == child:
        findings.add(reader.whose, f'parent and child must be two links, got {child!r} twice')
    axis = _read_axis(reader, 'axis', type_, WITH_AXIS)
    axis2 = _read_axis(reader, 'axis2', type_, ('universal',))
    damping, friction = _read_dynamics(reader, type_)
    if len(findings.items) > before:
        return None
    return LoopElement(
        name, type_, parent, parent_origin, child, child_origin, axis, axis2, damping, friction
    )


def _one(reader: Reader, tag: str, needed: bool) -> Element | None:
    found = reader.element.findall(tag)
    if len(found) > 1 or (needed and not found):
        reader.findings.add(reader.whose, f'<{tag}> must occur once, got {len(found)}')
    return found[0] if found else None


def _read_end(reader: Reader, tag: str, links: Collection[str]) -> tuple[str, Array]:
    element = _one(reader, tag, needed=True)
    if element is None:
        return '', np.eye(4)
    end = Reader(element, reader.whose, reader.findings, f' of <{tag}>')
    end.only(('link', 'xyz', 'rpy'))
    link = end.text('link')
    if link and link not in links:
        end.fail('link', 'be a link of the robot', link)
    return link, end.pose()


def _read_axis(reader: Reader, tag: str, type_: str, types: Collection[str]) -> Array | None:
    element = _one(reader, tag, needed=type_ in types)
    if element is None:
        return None
    if type_ and type_ not in types:
        reader.findings.add(reader.whose, f'<{tag}> must not occur in a {type_} loop, got one')
    axis = Reader(element, reader.whose, reader.findings, f' of <{tag}>')
    axis.only(('xyz',))
    return axis.axis()


def _read_dynamics(reader: Reader, type_: str) -> tuple[float, float]:
    element = _one(reader, 'dynamics', needed=False)
    if element is None:
        return 0.0, 0.0
    if type_ and type_ not in WITH_DYNAMICS:
        reader.findings.add(reader.whose, f'<dynamics> must not occur in a {type_} loop, got one')
    dynamics = Reader(element, reader.whose, reader.findings, ' of <dynamics>')
    dynamics.only(('damping', 'friction'))
    damping = dynamics.number('damping', least=0.0, default=0.0)
    return damping, dynamics.number('friction', least=0.0, default=0.0)


# elastic joints ---------------------------------------------------------------------------------

OF_SPRING = ('joint', 'stiffness', 'damping', 'stiffness3', 'backlash', 'measured')


def read_spring(
    element: Element, root: Element, springs: Mapping[str, Spring], findings: Findings
) -> tuple[str, Spring]:
    """Return a spring and the name of its joint.

    Parameters
    ----------
    findings : Findings
        Gathers what is wrong; with findings the numbers may be nan.
    """
    name = element.get('joint', '')
    reader = Reader(element, f'spring of joint {name!r}', findings)
    reader.only(OF_SPRING)
    found = {joint.get('name'): joint for joint in root.findall('joint')}.get(name)
    if reader.text('joint') and (found is None or found.get('type') == 'fixed'):
        reader.fail('joint', 'be a movable joint of the robot', name)
    elif found is not None and found.find('mimic') is not None:
        reader.fail('joint', 'be no mimic joint: give the spring to its leader', name)
    if name in springs:
        findings.add(reader.whose, 'must occur once, got it twice')
    slides = found is not None and found.get('type') == 'prismatic'
    units = (JointKind.PRISMATIC if slides else JointKind.REVOLUTE).units
    return name, Spring(
        reader.number('stiffness', units['stiffness'], above=0.0),
        reader.number('damping', units['spring_damping'], least=0.0, default=0.0),
        reader.number('stiffness3', units['stiffness3'], least=0.0, default=0.0),
        reader.number('backlash', units['backlash'], least=0.0, default=0.0),
        reader.choice('measured', SIDES, SIDES[0]),
    )


def check_springs(
    robot: RigidUrdf,
    springs: Mapping[str, Spring],
    armatures: Mapping[str, float],
    loops: Iterable[LoopElement],
    findings: Findings,
    warnings: list[str],
) -> None:
    """Note springs of joints that a loop closes over, and those without a rotor's inertia."""
    before = {joint.child: joint for joint in robot.joints if joint.kind is not JointKind.FIXED}
    over = {joint.child: joint for joint in robot.joints}

    def support(link: str) -> set[str]:
        names = set()
        while link in over:
            if link in before:
                names.add(before[link].name)
            link = over[link].parent
        return names

    for loop in loops:
        for name in sorted((support(loop.parent) ^ support(loop.child)) & set(springs)):
            rule = f'joint must be outside of every loop, got one that {loop.name!r} closes over'
            findings.add(f'spring of joint {name!r}', rule)
    for name in springs:
        armature = armatures.get(name, 0.0)
        if not armature > 0.0:
            rule = 'armature of <actuator> should be > 0 (forward dynamics need it)'
            warnings.append(f'spring of joint {name!r}: {rule}, got {armature:g}')
