"""`<spring>`: an elastic joint (gear, cable, belt), read and validated."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from denoc_ros.model.findings import Element, Findings, Reader
from denoc_ros.model.loops import LoopElement
from denoc_ros.model.rigid_urdf import RigidUrdf
from denoc_ros.model.tree import SIDES, JointKind, Spring

ATTRIBUTES = ('joint', 'stiffness', 'damping', 'stiffness3', 'backlash', 'measured')


def read_spring(
    element: Element, root: Element, springs: Mapping[str, Spring], findings: Findings
) -> tuple[str, Spring]:
    """Return a spring and the name of its joint.

    Parameters
    ----------
    element : lxml element
        `<spring>`.
    root : lxml element
        `<robot>`.
    springs : mapping of str to Spring
        The springs before it, by joint.
    findings : Findings
        Gathers what is wrong; with findings the numbers may be nan.

    Returns
    -------
    tuple of str and Spring
    """
    name = element.get('joint', '')
    reader = Reader(element, f'spring of joint {name!r}', findings)
    reader.only(ATTRIBUTES)
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
    """Note springs of joints that a loop closes over, and those without a rotor's inertia.

    Parameters
    ----------
    robot : RigidUrdf
        Links and joints.
    springs, armatures : mapping by joint
    loops : iterable of LoopElement
    findings : Findings
        Gathers what is wrong.
    warnings : list of str
        Gathers what keeps forward dynamics from being solved.
    """
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
