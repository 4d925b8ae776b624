"""Sections of a beam as the file says them: `<section>`, `<material>`, and `<at>` along it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.interpolate import PchipInterpolator

from denoc_ros.errors import ModelError
from denoc_ros.model.beams.along import Along, fitted, mean_and_along, sample_shares
from denoc_ros.model.beams.cross_sections import (
    AXES,
    CENTRED,
    CrossSection,
    SectionAxes,
    rectangle_section,
    round_section,
    tube_section,
)
from denoc_ros.model.reading.findings import Element, Findings, Reader
from denoc_ros.model.reading.mesh_files import named_file
from denoc_ros.model.reading.poses import number_text, rpy_of
from denoc_ros.types import Array

SIZES = {'round': ('diameter',), 'tube': ('diameter', 'wall'), 'rectangle': ('y', 'z')}
SHAPED: dict[str, Callable[..., CrossSection]] = {
    'round': round_section,
    'tube': tube_section,
    'rectangle': rectangle_section,
}
NUMBERS = {
    'ei_y': 'N m^2',
    'ei_z': 'N m^2',
    'gj': 'N m^2',
    'mass_per_length': 'kg/m',
    'polar_inertia': 'kg m^2/m',
    'ea': 'N',
}
OF_SECTION = tuple(NUMBERS)[:5]
PROFILE = 'profile'  # kind of a section with an outline of its own
MOST_STATIONS = 1000
SAME_STATION = 1e-9  # of the length
INTERPOLATIONS = ('linear', 'cubic')
STRAINS = ('strain_limit', 'stress_limit', 'surface')


@dataclass(frozen=True)
class BeamSection:
    """A cross-section with its material."""

    kind: str  # of SIZES, or PROFILE
    sizes: tuple[float, ...]  # [m]
    e: float  # Young's modulus [Pa]
    g: float  # shear modulus [Pa]
    density: float  # [kg/m^3]
    profile: CrossSection | None = None

    @cached_property
    def section(self) -> CrossSection:
        """The numbers of its shape."""
        if self.profile is not None:
            return self.profile
        if self.kind not in SHAPED or not np.isfinite(self.sizes).all():
            return CrossSection(math.nan, math.nan, math.nan, math.nan)
        return SHAPED[self.kind](*self.sizes)

    @property
    def mass_per_length(self) -> float:
        """[kg/m]."""
        return self.density * self.section.area

    @property
    def polar_inertia(self) -> float:
        """Polar inertia per length [kg m^2/m]."""
        return self.density * self.section.polar_moment

    @property
    def warping_rigidity(self) -> float:
        """E Gamma [N m^4]; 0 where it is not known."""
        return self.e * self.section.warping_constant

    @property
    def torsional_rigidity(self) -> float:
        """GJ [N m^2]."""
        return self.g * self.section.torsion_constant

    def flexural_rigidity(self, direction: str) -> float:
        """Return EI [N m^2] for a deflection along y or z."""
        section = self.section
        return self.e * (section.moment_y if direction == 'y' else section.moment_z)


@dataclass(frozen=True)
class StrainLimit:
    """The largest strain of a beam that a plan may need."""

    strain: float = math.inf  # of the outer fibre; inf: none
    surface: tuple[float, float] = (0.0, 0.0)  # how far it is along y and z [m]; 0: not known
    corners: bool = False  # whether strains of both directions add up in the section's corners
    of_section: bool = False  # whether the beam has one `<section>`


NO_LIMIT = StrainLimit()


def read_strain_limit(beam: Reader, section: BeamSection | None) -> StrainLimit:
    """Return the strain limit of a `<beam>` and its outer fibre: the section's, or `surface`."""
    given = {name: beam.element.get(name) is not None for name in STRAINS}
    surface, corners, strain = (0.0, 0.0), False, math.inf
    if given['surface']:
        depth = beam.number('surface', 'm', above=0.0)
        surface = (depth, depth)
        if section is not None:
            beam.fail('surface', 'not come with a <section>', depth)
    elif section is not None and section.sizes:
        corners = section.kind in ('rectangle', PROFILE)
        surface = (0.5 * section.sizes[0], 0.5 * section.sizes[1 if corners else 0])
    if given['strain_limit']:
        strain = beam.number('strain_limit', '-', above=0.0)
        if not any(surface):
            beam.fail('strain_limit', 'come with a <section> or with surface', strain)
    if given['stress_limit']:
        stress = beam.number('stress_limit', 'Pa', above=0.0)
        if section is None:
            beam.fail('stress_limit', 'come with a <section> and its <material>', stress)
        else:
            strain = min(strain, stress / section.e)
    return StrainLimit(strain, surface, corners, section is not None)


def at_most_one(reader: Reader, tag: str) -> Element | None:
    """Return the only child of a tag, None without one; note a second."""
    found = reader.element.findall(tag)
    if len(found) > 1:
        reader.findings.add(reader.whose, f'<{tag}> must occur once, got {len(found)}')
    return found[0] if found else None


def read_section(beam: Reader, least: float | None = None, folder: str = '') -> BeamSection | None:
    """Return the `<section>` of a beam, or of a station of it, None without one.

    Parameters
    ----------
    beam : Reader
        Of `<beam>` or of its `<at>`, whose `<material>` may stand in the beam.
    least : float, optional
        Of the sizes [m]; they are > 0 where it is not given.
    folder : str
        Of the description's file, which the file of an outline is relative to; '' of a text.
    """
    element = at_most_one(beam, 'section')
    station = beam.element.tag == 'at'
    materials = beam.element.findall('material')
    if element is None:
        if materials and beam.element.find('at/section') is None:
            beam.findings.add(beam.whose, '<material> must come with a <section>, got none')
        return None
    reader = Reader(element, beam.whose, beam.findings, f' of <section>{beam.label}')
    profile = None
    if element.get('file') is not None or element.get('type') == 'polygon':
        profile = _read_outline(reader, folder)
        fibre = (0.0, 0.0) if profile is None else profile.fibre
        section: tuple[str, tuple[float, ...]] = (PROFILE, (2.0 * fibre[0], 2.0 * fibre[1]))
    else:
        section = _read_sizes(reader, least)
    materials += element.findall('material')
    whole = beam.element.getparent() if station else beam.element
    if station and whole is not None:
        materials += whole.findall('material')
    if len(materials) != 1:
        rule = f'must have one <material>, got {len(materials)}'
        beam.findings.add(beam.whose, f'<section> {rule}')
        return BeamSection(*section, math.nan, math.nan, math.nan)
    material = Reader(materials[0], beam.whose, beam.findings, ' of <material>')
    material.only(('e', 'g', 'density'))
    bends, twists = (
        whole is not None and whole.find(tag) is not None for tag in ('bending', 'torsion')
    )
    return BeamSection(
        *section,
        material.number('e', 'Pa', above=0.0, default=None if bends else math.nan),
        material.number('g', 'Pa', above=0.0, default=None if twists else math.nan),
        material.number('density', 'kg/m^3', above=0.0),
        profile,
    )


def expand_section(beam: Element, folder: str = '') -> None:
    """Replace a beam's `<section>` by the numbers that it gives; leave a bad one to be found.

    Parameters
    ----------
    beam : lxml element
        `<beam>`, changed in place.
    folder : str
        Of the description's file, '' of a text.
    """
    scratch = Findings()
    section = read_section(Reader(beam, '', scratch), folder=folder)
    if section is None or scratch.items:
        return
    limit = read_strain_limit(Reader(beam, '', scratch), section)
    if beam.attrib.pop('stress_limit', None) is not None or math.isfinite(limit.strain):
        beam.set('strain_limit', repr(limit.strain))
        beam.set('surface', repr(max(limit.surface) * (2.0**0.5 if limit.corners else 1.0)))
    for element in beam.findall('section') + beam.findall('material'):
        beam.remove(element)
    if (axes := section.section.axes) is not None:
        _turn_origin(beam, axes)
    beam.set('mass_per_length', repr(section.mass_per_length))
    for bending in beam.findall('bending'):
        bending.set('ei', repr(section.flexural_rigidity(bending.get('direction'))))
    for torsion in beam.findall('torsion'):
        torsion.set('gj', repr(section.torsional_rigidity))
        torsion.set('polar_inertia', repr(section.polar_inertia))


def _read_sizes(reader: Reader, least: float | None) -> tuple[str, tuple[float, ...]]:
    kind = reader.choice('type', (*SIZES, 'polygon'))
    names = SIZES.get(kind, ())
    reader.only(('type', *names) if kind else tuple(reader.element.attrib), ('material',))
    above = 0.0 if least is None else None
    numbers = [reader.number(name, 'm', above=above, least=least) for name in names]
    if kind == 'tube' and 2.0 * numbers[1] > numbers[0]:
        reader.fail('wall', f'be at most half the diameter {numbers[0]:g} m', numbers[1])
    return kind, tuple(numbers)


def _turn_origin(beam: Element, axes: SectionAxes) -> None:
    """Put the principal axes of a section into the beam's `<origin>`."""
    element = beam.find('origin')
    pose = np.eye(4) if element is None else Reader(element, '', Findings()).pose()
    pose = pose @ axes.pose
    if element is None:
        element = type(beam).makeelement(beam, 'origin')
        beam.insert(0, element)
    element.set('xyz', number_text(*pose[:3, 3]))
    element.set('rpy', number_text(*rpy_of(pose[:3, :3])))


def _read_outline(reader: Reader, folder: str) -> CrossSection | None:
    """Return the numbers of `<section file= scale=>` or `<section type="polygon" points=>`."""
    try:  # an extra, for such sections alone
        from denoc_ros.model.beams.section_profiles import profile_section, read_outline
    except ImportError as error:
        rule = "must be read with sectionproperties: pip install 'denoc_ros[sections]'"
        reader.findings.add(reader.whose, f'outline of <section> {rule}, got: {error}')
        return None
    try:
        if reader.element.get('file') is None:
            reader.only(('type', 'points'), ('material',))
            points = reader.numbers('points', 'm')
            if len(points) < 6 or len(points) % 2:
                reader.fail('points', 'be y and z of three corners or more', len(points))
                return None
            return profile_section(
                (tuple((float(y), float(z)) for y, z in points.reshape(-1, 2)),)
            )
        reader.only(('file', 'scale'), ('material',))
        scale = reader.number('scale', 'm per unit of the file', above=0.0)
        file = named_file(reader, folder)
        if file is None or not math.isfinite(scale):
            return None
        return profile_section(read_outline(file, scale))
    except ModelError as error:
        for finding in error.findings:
            name = reader.element.get('file', 'polygon')
            reader.findings.add(f'{reader.whose}: <section> {name}', finding)
        return None


Profile = tuple[float, Along]  # mean and shares of it


@dataclass(frozen=True)
class _Station:
    x: float  # m
    numbers: dict[str, float]
    section: BeamSection | None


@dataclass(frozen=True)
class Stations:
    """Numbers of a beam by the names of `NUMBERS`, and where its sections lie."""

    profiles: Mapping[str, Profile] = field(default_factory=dict)
    axes: SectionAxes | None = None  # None: centred on the beam axis
    warping_rigidity: float = 0.0  # the largest E Gamma [N m^4]


def read_stations(beam: Reader, length: float, folder: str = '') -> Stations:
    """Return the stations of the `<at>` elements of a beam.

    Parameters
    ----------
    beam : Reader
        Of `<beam>`.
    length : float
        [m]
    folder : str
        Of the description's file, '' of a text.

    Returns
    -------
    Stations
        Mean over the length and the shares of it along the beam; empty without `<at>`.
    """
    interpolation = beam.choice('interpolation', INTERPOLATIONS, 'linear')
    elements = beam.element.findall('at')
    if not elements:
        if beam.element.get('interpolation') is not None:
            beam.fail('interpolation', 'come with <at> stations', interpolation)
        return Stations()
    before = len(beam.findings.items)
    if len(elements) > MOST_STATIONS or len(elements) < 2:
        rule = f'must be 2 to {MOST_STATIONS}'
        beam.findings.add(beam.whose, f'number of <at> stations {rule}, got {len(elements)}')
        return Stations()
    if beam.element.find('section') is not None:
        beam.findings.add(beam.whose, '<section> must stand in each <at>, got one in <beam>')
    last = len(elements) - 1
    stations = [_read_station(beam, at, k == last, folder) for k, at in enumerate(elements)]
    _check_places(beam, [station.x for station in stations], length)
    if len(beam.findings.items) > before:
        return Stations()
    given = [station.section is not None for station in stations]
    if any(given) and not all(given):
        rule = 'must have a <section> each, or none'
        beam.findings.add(beam.whose, f'<at> stations {rule}, got {sum(given)} of {len(given)}')
        return Stations()
    x = np.array([station.x for station in stations]) / length
    x[-1] = 1.0
    x[np.flatnonzero(np.diff(x) <= SAME_STATION) + 1] = x[:-1][np.diff(x) <= SAME_STATION]
    if all(given):
        return _from_sections(beam, x, [s.section for s in stations if s.section], interpolation)
    return _from_numbers(beam, x, stations, interpolation)


def _read_station(beam: Reader, element: Element, last: bool, folder: str) -> _Station:
    where = element.get('x', '')
    reader = Reader(element, beam.whose, beam.findings, f' of <at x={where!r}>')
    reader.only(('x', *NUMBERS, *AXES), ('section', 'material'))
    # a beam may end in a point, where nothing is left of its section
    bound: dict[str, float] = {'least': 0.0} if last else {'above': 0.0}
    given = {name for name in (*NUMBERS, *AXES) if element.get(name) is not None}
    numbers = {
        name: reader.number(name, unit, **bound) for name, unit in NUMBERS.items() if name in given
    }
    numbers |= {name: reader.number(name, unit) for name, unit in AXES.items() if name in given}
    if element.find('section') is not None and numbers:
        reader.fail(next(iter(numbers)), 'not come with a <section>', next(iter(numbers.values())))
    section = read_section(reader, 0.0 if last else None, folder)
    return _Station(reader.number('x', 'm', least=0.0), numbers, section)


def _check_places(beam: Reader, x: list[float], length: float) -> None:
    if not np.isfinite([*x, length]).all():
        return
    near, steps = SAME_STATION * length, np.diff(x)
    place = 'x of <at>'
    shown = ' '.join(f'{each:g}' for each in x[:20])
    if abs(x[0]) > near or abs(x[-1] - length) > near:
        rule = f'must begin at 0 and end at the length {length:g} m'
        beam.findings.add(beam.whose, f'{place} {rule}, got {shown}')
    if (steps < -near).any():
        beam.findings.add(beam.whose, f'{place} must rise, got {shown}')
        return
    equal = np.abs(steps) <= near
    if (equal[1:] & equal[:-1]).any():
        rule = 'must be equal for two stations at most, which make a step'
        beam.findings.add(beam.whose, f'{place} {rule}, got {shown}')
    if equal[0] or equal[-1]:
        rule = 'must not step at the root or the tip'
        beam.findings.add(beam.whose, f'{place} {rule}, got {shown}')


def _interpolated(x: Array, rows: Array, interpolation: str) -> list[Callable[[Array], Array]]:
    """Return functions of the share (n,) of each interval, to (n, columns), without the steps."""
    steps = np.flatnonzero(np.diff(x) == 0.0)

    def between(a: int, b: int, curve: PchipInterpolator | None) -> Callable[[Array], Array]:
        if curve is None:
            return lambda s: np.asarray(rows[a] + s[:, None] * (rows[b] - rows[a]))
        return lambda s: np.asarray(curve(x[a] + s * (x[b] - x[a])))

    found = []
    for run in np.split(np.arange(len(x)), steps + 1):
        curve = PchipInterpolator(x[run], rows[run]) if interpolation == 'cubic' else None
        found += [between(a, b, curve) for a, b in itertools.pairwise(run)]
    return found


def _from_numbers(
    beam: Reader, x: Array, stations: list[_Station], interpolation: str
) -> Stations:
    found = {}
    for name, unit in NUMBERS.items():
        column = [station.numbers.get(name) for station in stations]
        given = [value for value in column if value is not None]
        if not given:
            continue
        if len(given) < len(column):
            none = ', or at none' if name != 'ea' else ', or left out: the beam does not stretch'
            rule = f'must be given at each station{none} [{unit}]'
            beam.findings.add(beam.whose, f'{name} of <at> {rule}, got {len(given)}')
            continue
        found[name] = mean_and_along(*_sampled(x, np.array(given), interpolation))
    if not found and len(beam.findings.items) == 0:
        rule = f'must have a <section> or numbers ({", ".join(NUMBERS)})'
        beam.findings.add(beam.whose, f'<at> stations {rule}, got none')
    return Stations(found, _axes_along(x, [each.numbers for each in stations], interpolation))


def _sampled(x: Array, values: Array, interpolation: str) -> tuple[Array, list[Array]]:
    """Return the breaks of a column of stations, and its samples between each two."""
    curves = _interpolated(x, values[:, None], interpolation)
    return np.unique(x), [curve(sample_shares())[:, 0] for curve in curves]


def _axes_along(
    x: Array, rows: Sequence[Mapping[str, float]], interpolation: str
) -> SectionAxes | None:
    """Return where sections lie; a shear centre that is not given is the centroid."""
    if not any(name in row for row in rows for name in AXES):
        return None
    columns = {name: np.array([row.get(name, 0.0) for row in rows]) for name in list(AXES)[:3]}
    for axis in 'yz':
        columns[f'shear_center_{axis}'] = np.array(
            [row.get(f'shear_center_{axis}', row.get(f'centroid_{axis}', 0.0)) for row in rows]
        )
    return SectionAxes(*(fitted(*_sampled(x, columns[n], interpolation)) for n in AXES))


def _from_sections(
    beam: Reader, x: Array, sections: list[BeamSection], interpolation: str
) -> Stations:
    for k, (one, next_) in enumerate(itertools.pairwise(sections)):
        if one.kind != next_.kind and x[k] < x[k + 1]:
            rule = 'type must be that of the station before, or change in a step (two at one x)'
            got = f'{one.kind} and {next_.kind}'
            beam.findings.add(beam.whose, f'<section> of <at>: {rule}, got {got}')
            return Stations()
    if any(each.kind == PROFILE for each in sections):
        # outlines have no sizes in common: their numbers are interpolated
        numbers = np.nan_to_num([_numbers_of(each) for each in sections])
        samples = [curve(sample_shares()) for curve in _interpolated(x, numbers, interpolation)]
        own = [each.section.axes or CENTRED for each in sections]
        rows = [dict(zip(AXES, axes.values(np.zeros(1))[0], strict=True)) for axes in own]
        axes = _axes_along(x, rows, interpolation)
        warping = max(each.warping_rigidity for each in sections)
    else:
        axes, warping = None, 0.0
        # sizes of each type stand in columns of their own
        most = max(len(each.sizes) for each in sections)
        sizes = [
            [*each.sizes, *[0.0] * (most - len(each.sizes)), each.e, each.g, each.density]
            for each in sections
        ]
        curves = _interpolated(x, np.nan_to_num(sizes), interpolation)
        begins = np.flatnonzero(np.diff(x) > 0.0)
        samples = [
            np.array([_numbers_of(_section(sections[at], row)) for row in curve(sample_shares())])
            for at, curve in zip(begins, curves, strict=True)
        ]
    found = {
        name: mean_and_along(np.unique(x), [interval[:, k] for interval in samples])
        for k, name in enumerate(OF_SECTION)
    }
    return Stations(found, axes, warping)


def _numbers_of(section: BeamSection) -> list[float]:
    """Return the numbers OF_SECTION."""
    return [
        *(section.flexural_rigidity(axis) for axis in 'yz'),
        section.torsional_rigidity,
        section.mass_per_length,
        section.polar_inertia,
    ]


def _section(like: BeamSection, row: Array) -> BeamSection:
    e, g, density = (float(value) for value in row[-3:])
    sizes = tuple(float(value) for value in row[: len(like.sizes)])
    if like.kind == 'tube':  # curves through two sizes may cross between stations
        sizes = (sizes[0], min(sizes[1], 0.5 * sizes[0]))
    return BeamSection(like.kind, sizes, e, g, density)
