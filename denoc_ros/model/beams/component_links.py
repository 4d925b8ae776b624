"""`<flexible>`: a link reduced from finite elements, and the frames that things hang on."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from denoc_ros.errors import ModelError
from denoc_ros.model.beams.link_file import ReducedLink, read
from denoc_ros.model.inertia import ROUNDING, TOLERANCE, difference, inertia_violation
from denoc_ros.model.reading.findings import SMALLEST, Element, Findings, Reader
from denoc_ros.model.reading.mesh_files import named_file
from denoc_ros.model.tree import ComponentModes, FlexibleLink, RigidInertia
from denoc_ros.types import Array

ATTRIBUTES = ('link', 'file', 'stiffness', 'damping_ratio', 'damping', 'inertial')
INERTIALS = ('urdf', 'file')  # whose mass and inertia the link has
PLACE_TOLERANCE = 1e-6  # of the link's size: as near as a frame must be to be found by its place
SAME_MASS = 1e-6  # of the link's: a mass that differs by less is that of the <inertial>
ASIDE = 1e-3  # of the link's size: farther, a frame is not where its joint is


@dataclass(frozen=True)
class FlexibleElement:
    """`<flexible>` as the files say it."""

    link: str
    modes: ComponentModes
    inertial: str  # one of INERTIALS


def read_flexible(
    element: Element, links: Collection[str | None], folder: str, findings: Findings
) -> FlexibleElement | None:
    """Return a `<flexible>`, None if it has findings.

    Parameters
    ----------
    element : lxml element
    links : collection of str
        The robot's.
    folder : str
        Of the description's file, which `file` is relative to; '' of a text, where `file` must be
        an absolute path or a `package://` address.
    findings : Findings
        Gathers what is wrong, in the description and in the file that it names.
    """
    before, link = len(findings.items), element.get('link', '')
    reader = Reader(element, f'flexible {link!r}', findings)
    reader.only(ATTRIBUTES)
    if reader.text('link') and link not in links:
        reader.fail('link', 'be a link of the robot', link)
    factor = reader.number('stiffness', above=0.0, default=1.0)
    inertial = reader.choice('inertial', INERTIALS, 'urdf')
    found = _read_file(reader, folder)
    if found is None or len(findings.items) > before:
        return None
    path, reduced = found
    modes = ComponentModes(path, reduced, reduced.stiffness, np.zeros(reduced.modes))
    damped = _damped(reader, modes.with_stiffness(factor))
    if len(findings.items) > before or damped is None:
        return None
    return FlexibleElement(link, damped, inertial)


def _read_file(reader: Reader, folder: str) -> tuple[str, ReducedLink] | None:
    path = named_file(reader, folder)
    if path is None:
        return None
    status = path.stat()
    try:
        return str(path.resolve()), _read(str(path), status.st_mtime_ns, status.st_size)
    except ModelError as error:
        for finding in error.findings:
            reader.findings.add(f'{reader.whose}: {reader.text("file")}', finding)
        return None


@lru_cache(maxsize=16)
def _read(path: str, _changed: int, _size: int) -> ReducedLink:
    return read(path)


def _damped(reader: Reader, modes: ComponentModes) -> ComponentModes | None:
    """Return modes damped as the description says, else as the file does; None if bad."""
    link, count = modes.link, modes.count
    given: dict[str, Array | None] = {'damping_ratio': None, 'damping': None}
    for name, unit in (('damping_ratio', '-'), ('damping', 'N s/m')):
        text = reader.element.get(name)
        if text is not None:
            values = reader.numbers(name, unit, least=0.0)
            if len(values) not in (1, count):
                if len(values):
                    reader.fail(name, f'have one number, or one for each of {count} modes', text)
                return None
            given[name] = values
    if given['damping_ratio'] is not None and given['damping'] is not None:
        reader.fail('damping', 'not come with damping_ratio', reader.element.get('damping'))
        return None
    ratio, damping = given['damping_ratio'], given['damping']
    if ratio is None and damping is None:
        ratio, damping = link.damping_ratio, link.damping
    if ratio is not None:
        return replace(modes, damping=ratio * modes.critical_damping, damping_ratio=ratio)
    return modes if damping is None else replace(modes, damping=damping * np.ones(count))


def component_link(
    element: FlexibleElement,
    inertia: RigidInertia | None,
    findings: Findings,
    warnings: list[str],
) -> FlexibleLink | None:
    """Return a link's modes and its rigid rest, None if the link does not allow it.

    Parameters
    ----------
    inertia : RigidInertia or None
        The whole link about its link frame; None without an `<inertial>`.
    findings : Findings
        Gathers what is wrong.
    warnings : list of str
        Gathers what is doubtful.
    """
    whose, reduced = f'flexible {element.link!r}', element.modes.link
    own = RigidInertia(reduced.mass, reduced.mass * reduced.com, reduced.inertia)
    if element.inertial == 'file':
        if inertia is not None and abs(inertia.mass - own.mass) > SAME_MASS * own.mass:
            said = f'its file has {own.mass:.6g} kg, which the link takes'
            warnings.append(f'{whose}: <inertial> says {inertia.mass:.6g} kg, {said}')
        return FlexibleLink(np.eye(4), (), RigidInertia(), element.modes)
    if inertia is None or inertia.mass < SMALLEST:
        got = 'none' if inertia is None else f'mass {inertia.mass:g} kg'
        rule = "link must have a mass, of which the file's is a share: the link's <inertial>"
        findings.add(whose, f'{rule}, or inertial="file", got {got}')
        return None
    rest = difference(inertia, own)
    lack = inertia_violation(rest, inertia)
    rule = "rest of the link beside the file's must be physically possible"
    got = f'mass {inertia.mass:.6g} kg of the link, {own.mass:.6g} kg of the file'
    if lack > TOLERANCE:
        off = f'{lack:.3g} of it below zero'
        findings.add(whose, f'{rule}, or inertial="file" given, got {got}, {off}')
        return None
    if lack > ROUNDING:
        warnings.append(f'{whose}: {rule}, got within rounding: {got}')
    return FlexibleLink(np.eye(4), (), rest, element.modes)


def find_frame(link: ReducedLink, origin: Array, names: Collection[str]) -> str | None:
    """Return the name of the frame that something hangs on.

    Parameters
    ----------
    origin : ndarray (4, 4)
        Where it hangs, undeformed, in the link frame.
    names : collection of str
        The names that its frame may have, the first that fits.

    Returns
    -------
    str or None
        A frame that is called so, else one that stands there; '' at the link frame itself; None
        if there is none.
    """
    for name in names:
        if name in link.frames:
            return name
    place = origin[:3, 3]
    near = PLACE_TOLERANCE * _size(link)
    if float(np.linalg.norm(place)) <= near:
        return ''
    found = (n for n, at in link.frames.items() if np.linalg.norm(at.origin - place) <= near)
    return next(found, None)


def check_frame(
    whose: str,
    element: FlexibleElement,
    origin: Array,
    names: Collection[str],
    findings: Findings,
    warnings: list[str],
) -> None:
    """Note children that hang on no frame of a link, or far from their own."""
    link = element.modes.link
    name = find_frame(link, origin, names)
    if name is None:
        known = ', '.join(link.frames) or 'none'
        called = ' or '.join(repr(each) for each in names)
        rule = f'flexible link {element.link!r} must have a frame {called}, or one at its origin'
        findings.add(whose, f'{rule}, got {known}')
    elif name:
        aside = float(np.linalg.norm(link.frames[name].origin - origin[:3, 3]))
        if aside > ASIDE * _size(link):
            rule = f'frame {name!r} of flexible link {element.link!r} must stand at its origin'
            warnings.append(f'{whose}: {rule}, got {aside:.3g} m off, taken as a rigid arm')


def _size(link: ReducedLink) -> float:
    far = [float(np.linalg.norm(frame.origin)) for frame in link.frames.values()]
    return max([*far, float(np.linalg.norm(link.com))])
