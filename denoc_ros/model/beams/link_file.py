"""The file of a link reduced from finite elements: its modes, their integrals and its frames.

An `.npz` of arrays alone (`np.load(allow_pickle=False)` reads it), SI, all in the link frame. The
displacement of a material point that stands at r undeformed is, with the amplitudes d (m,),

    u = sum_j Phi_j(r) d_j + 1/2 sum_jk Gamma_jk(r) d_j d_k,

with Gamma_jk = Gamma_kj, and a frame turns by Exp(Theta d). All integrals that the dynamics need
are inner products, under the mass measure, of the functions 1, x, y, z and the components of Phi
and Gamma: a factor of their Gram matrix says them all, to rounding.
"""

from __future__ import annotations

import math
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from denoc_ros.decompression import require_bounded_archive
from denoc_ros.errors import ModelError
from denoc_ros.types import Array

SCHEMA = 1
UNITS = 'SI'
MOST_MODES = 64
MOST_BYTES = 256 << 20  # of all arrays of a file
MOST_MEMBERS = 10_000
MOST_TEXT = 100_000  # characters of a text
ROUNDING = 1e-6  # by which mass, centre and inertia may differ from the points'
UNIT_ROUNDING = 1e-6  # by which a direction or a rotation may be off


@dataclass(frozen=True)
class LinkFrame:
    """A frame of the link: where a joint, a child or a loop attaches.

    `origin` (3,) [m] and `rotation` (3, 3), undeformed; `phi` (3, m) and `theta` (3, m): its
    displacement and turn [rad] per amplitude; `quadratic` (3, g): Gamma_jk there, a column per
    pair of `ReducedLink.pairs`.
    """

    origin: Array
    rotation: Array
    phi: Array
    theta: Array
    quadratic: Array


@dataclass(frozen=True)
class StrainPoint:
    """A point of the surface where a gauge may sit.

    `origin` (3,) [m], `direction` (3,) of the gauge, a unit vector; `row` (m,): strain per
    amplitude.
    """

    origin: Array
    direction: Array
    row: Array


@dataclass(frozen=True)
class Surface:
    """The surface, for pictures: `strain` components are xx, yy, zz, yz, xz, xy (none doubled)."""

    nodes: Array  # (s, 3) [m]
    faces: NDArray[np.int64]  # (f, 3) of nodes, seen anticlockwise from outside
    phi: Array  # (s, 3, m) displacement per amplitude
    strain: Array  # (s, 6, m) strain per amplitude; (0, 6, m) where the file has none


@dataclass(frozen=True)
class ReducedLink:
    """A link reduced from finite elements, SI, in the link frame; m modes, g quadratic terms."""

    mass: float  # kg
    com: Array  # (3,) centre of mass [m]
    inertia: Array  # (3, 3) about the link frame's origin [kg m^2]
    # (k, 4 + 3 m + 3 g): rows of a factor R of the Gram matrix R^T R of the functions 1, x, y, z,
    # Phi_1x, Phi_1y, Phi_1z, Phi_2x, ..., then Gamma_x, Gamma_y, Gamma_z of each of `pairs`
    points: Array
    stiffness: Array  # (m,) [N/m, or what the amplitude's unit makes it]
    pairs: NDArray[np.int64]  # (g, 2) modes j <= k of each quadratic term, from 0; none twice
    frames: Mapping[str, LinkFrame]
    damping: Array | None = None  # (m,) coefficients; at most one of the two is given
    damping_ratio: Array | None = None  # (m,) of critical damping, root clamped
    strain: Mapping[str, StrainPoint] = field(default_factory=dict)
    surface: Surface | None = None
    frequencies: Array = field(default_factory=lambda: np.zeros(0))  # [Hz] root clamped, kept
    frequencies_left_out: Array = field(default_factory=lambda: np.zeros(0))  # [Hz] the next ones
    # per frame, (6,) of the static compliance under a unit force and moment there, along x, y, z
    # each: percent of it that the modes lack
    left_out: Mapping[str, Array] = field(default_factory=dict)
    source: str = ''  # mesh, material, program

    @property
    def modes(self) -> int:
        """Number of modes m."""
        return len(self.stiffness)

    @property
    def modal_mass(self) -> Array:
        """Mass (m,) of each mode with the link frame held."""
        columns = self.points[:, 4 : 4 + 3 * self.modes]
        return np.asarray((columns**2).sum(axis=0).reshape(-1, 3).sum(axis=1))


def write(path: str | Path, link: ReducedLink) -> None:
    """Write a link's file.

    Parameters
    ----------
    path : str or path
        An existing file is replaced.

    Raises
    ------
    ModelError
        With every finding that `read` would have.
    """
    arrays = _arrays(link)
    _checked(str(path), arrays)
    with Path(path).open('wb') as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def _arrays(link: ReducedLink) -> dict[str, NDArray[np.generic]]:
    """Return the arrays of a link by their names in the file."""
    found: dict[str, object] = {'schema': np.int64(SCHEMA), 'units': UNITS, 'source': link.source}
    for name in ('mass', 'com', 'inertia', 'points', 'stiffness', 'damping', 'damping_ratio'):
        if (value := getattr(link, name)) is not None:
            found[name] = value
    found['quadratic/index'] = np.asarray(link.pairs, dtype=np.int64).reshape(-1, 2)
    found['frequencies/kept'] = link.frequencies
    found['frequencies/left_out'] = link.frequencies_left_out
    for name, percent in link.left_out.items():
        found[f'left_out/{name}'] = percent
    for group, entries in (('frames', link.frames), ('strain', link.strain)):
        for name, entry in entries.items():
            for part in fields(entry):
                found[f'{group}/{name}/{part.name}'] = getattr(entry, part.name)
    if link.surface is not None:
        for part in fields(link.surface):
            found[f'surface/{part.name}'] = getattr(link.surface, part.name)
    return {name: np.asarray(value) for name, value in found.items()}


def read(path: str | Path) -> ReducedLink:
    """Read a link's file; nothing in it is ever executed, and no more than 256 MB are read.

    Parameters
    ----------
    path : str or path

    Raises
    ------
    ModelError
        If the file is missing, truncated, larger than it may be, holds pickles, or says something
        that no link is.
    """
    where = str(path)
    try:
        with zipfile.ZipFile(path) as archive:
            _require_small(archive)
            require_bounded_archive(Path(path), MOST_BYTES)
            arrays = _read_arrays(archive)
    except OSError as error:
        raise ModelError(where, [f'file must be readable, got {error.strerror}']) from error
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
        got = str(error) or 'less'
        raise ModelError(where, [f'file must be a whole .npz archive, got: {got}']) from error
    except (_RefusedError, ValueError) as error:
        raise ModelError(where, [str(error)]) from error
    return _checked(where, arrays)


def _checked(where: str, arrays: dict[str, NDArray[np.generic]]) -> ReducedLink:
    """Return the link that arrays say, or raise every finding."""
    findings: list[str] = []
    link = _Parts(arrays, findings).link()
    if link is not None:
        _check(link, findings)
    ModelError.raise_any(where, findings)
    assert link is not None
    return link


class _RefusedError(Exception):
    """An archive that is not read."""


def _require_small(archive: zipfile.ZipFile) -> None:
    members = archive.infolist()
    if len(members) > MOST_MEMBERS:
        raise _RefusedError(f'file must hold at most {MOST_MEMBERS} arrays, got {len(members)}')
    size = sum(member.file_size for member in members)
    if size > MOST_BYTES:
        raise _RefusedError(
            f'arrays must have at most {MOST_BYTES >> 20} MB, got {size / 2**20:.0f}'
        )


def _read_arrays(archive: zipfile.ZipFile) -> dict[str, NDArray[np.generic]]:
    arrays = {}
    for member in archive.infolist():
        name = member.filename.removesuffix('.npy')
        if name in arrays:
            raise _RefusedError(f'array {name!r} must stand once, got it twice')
        with archive.open(member) as file:
            arrays[name] = _read_array(name, file, member.file_size)
    return arrays


def _read_array(name: str, file: IO[bytes], size: int) -> NDArray[np.generic]:
    """Return one array, whose header must say the size that its member has."""
    whose = f'array {name!r} must'
    try:
        version = np.lib.format.read_magic(file)
        if version not in ((1, 0), (2, 0)):
            raise _RefusedError(f'{whose} be of .npy version 1 or 2, got {version[0]}')
        header = np.lib.format.read_array_header_1_0, np.lib.format.read_array_header_2_0
        shape, fortran, dtype = header[version[0] - 1](file)
    except ValueError as error:
        raise _RefusedError(f'{whose} be in .npy format, got: {error}') from error
    if dtype.hasobject:
        raise _RefusedError(f'{whose} hold numbers or text, got pickled objects')
    said = math.prod(shape) * dtype.itemsize
    if said > size or min(shape, default=0) < 0:
        raise _RefusedError(f'{whose} have the {said} bytes of its header, got {size}')
    content = file.read(said + 1)
    if len(content) != said:
        got = f'{len(content)}' if len(content) < said else 'more'
        raise _RefusedError(f'{whose} have the {said} bytes of its header, got {got}')
    return np.frombuffer(content, dtype).reshape(shape, order='F' if fortran else 'C')


class _Parts:
    """Makes a link of the arrays of a file; each that does not fit becomes a finding."""

    def __init__(self, arrays: dict[str, NDArray[np.generic]], findings: list[str]) -> None:
        self.arrays = arrays
        self.findings = findings
        self.taken: set[str] = set()
        self.sizes = {'m': 0, 'g': 0}

    def fail(self, name: str, rule: str, got: object) -> None:
        """Note that an array must be something else."""
        self.findings.append(f'array {name!r} must {rule}, got {got}')

    def numbers(self, name: str, *shape: int | str, given: bool = True) -> Array | None:
        """Return finite numbers of a shape; a letter stands for a size that the first says."""
        self.taken.add(name)
        if name not in self.arrays:
            if given:
                self.fail(name, 'be in the file', 'none')
            return None
        array = self.arrays[name]
        if array.dtype.kind not in 'fiu':
            self.fail(name, 'hold numbers', f'type {array.dtype}')
            return None
        if array.ndim == len(shape):
            for size, part in zip(array.shape, shape, strict=True):
                if isinstance(part, str):
                    self.sizes.setdefault(part, size)
        wanted = tuple(self.sizes.get(p, -1) if isinstance(p, str) else p for p in shape)
        if array.shape != wanted:
            said = ', '.join(str(part) for part in shape)
            sizes = ''.join(f', {p} = {self.sizes.get(p)}' for p in shape if isinstance(p, str))
            self.fail(name, f'have shape ({said}){sizes}', array.shape)
            return None
        found = np.array(array, dtype=np.float64)
        if not np.isfinite(found).all():
            self.fail(name, 'be finite', f'{np.count_nonzero(~np.isfinite(found))} that are not')
            return None
        return found

    def text(self, name: str) -> str:
        """Return a text."""
        self.taken.add(name)
        array = self.arrays.get(name)
        if (
            array is None
            or array.dtype.kind != 'U'
            or array.ndim
            or array.itemsize > 4 * MOST_TEXT
        ):
            self.fail(name, 'be one text', 'none' if array is None else f'type {array.dtype}')
            return ''
        return str(array)

    def entries(self, group: str, part: str) -> list[str]:
        """Return the names of a group's entries, in the order of the file."""
        whole = [name for name in self.arrays if name.startswith(f'{group}/')]
        names = [name[len(group) + 1 :] for name in whole if name.endswith(part)]
        return [name.removesuffix(part) for name in names if name != part]

    def frame(self, name: str) -> LinkFrame | None:
        """Return a frame."""
        parts = (
            self.numbers(f'frames/{name}/origin', 3),
            self.numbers(f'frames/{name}/rotation', 3, 3),
            self.numbers(f'frames/{name}/phi', 3, 'm'),
            self.numbers(f'frames/{name}/theta', 3, 'm'),
            self.numbers(f'frames/{name}/quadratic', 3, 'g', given=self.sizes['g'] > 0),
        )
        if parts[4] is None and not self.sizes['g']:
            parts = (*parts[:4], np.zeros((3, 0)))
        return LinkFrame(*parts) if all(p is not None for p in parts) else None  # type: ignore[arg-type]

    def strain_point(self, name: str) -> StrainPoint | None:
        """Return a strain point."""
        parts = (
            self.numbers(f'strain/{name}/origin', 3),
            self.numbers(f'strain/{name}/direction', 3),
            self.numbers(f'strain/{name}/row', 'm'),
        )
        return StrainPoint(*parts) if all(p is not None for p in parts) else None  # type: ignore[arg-type]

    def surface(self) -> Surface | None:
        """Return the surface, None where the file has none."""
        if not any(name.startswith('surface/') for name in self.arrays):
            return None
        self.sizes.pop('s', None)
        nodes = self.numbers('surface/nodes', 's', 3)
        faces = self.numbers('surface/faces', 'f', 3)
        phi = self.numbers('surface/phi', 's', 3, 'm')
        strain: Array | None = np.zeros((0, 6, self.sizes['m']))
        if 'surface/strain' in self.arrays and len(self.arrays['surface/strain'].shape[:1]):
            empty = self.arrays['surface/strain'].shape[0] == 0
            strain = self.numbers('surface/strain', 0 if empty else 's', 6, 'm')
        if nodes is None or faces is None or phi is None or strain is None:
            return None
        whole = faces.astype(np.int64)
        if (whole != faces).any() or (whole < 0).any() or (whole >= len(nodes)).any():
            self.fail('surface/faces', f'hold indices 0 to {len(nodes) - 1}', 'others')
            return None
        return Surface(nodes, whole, phi, strain)

    def link(self) -> ReducedLink | None:
        """Return the link, None if the file has a finding."""
        schema = self.arrays.get('schema')
        if schema is None or schema.shape or schema.dtype.kind not in 'iu' or schema != SCHEMA:
            self.fail('schema', f'be {SCHEMA}', 'none' if schema is None else schema)
            return None
        self.taken.add('schema')
        if (units := self.text('units')) != UNITS:
            self.fail('units', f'be {UNITS!r}', repr(units))
        source = self.text('source')
        for size, name in (('m', 'stiffness'), ('g', 'quadratic/index')):
            found = self.arrays.get(name)
            self.sizes[size] = 0 if found is None or not found.shape else found.shape[0]
        self.taken.add('quadratic/index')
        pairs = np.zeros((0, 2))
        if 'quadratic/index' in self.arrays:
            pairs = self.numbers('quadratic/index', 'g', 2)  # type: ignore[assignment]
        mass = self.numbers('mass')
        parts = (self.numbers('com', 3), self.numbers('inertia', 3, 3))
        columns = 4 + 3 * self.sizes['m'] + 3 * self.sizes['g']
        points = self.numbers('points', 'k', columns)
        stiffness = self.numbers('stiffness', 'm')
        damping = self.numbers('damping', 'm', given=False)
        ratio = self.numbers('damping_ratio', 'm', given=False)
        kept = self.numbers('frequencies/kept', 'a', given=False)
        left = self.numbers('frequencies/left_out', 'b', given=False)
        lost = {n: self.numbers(f'left_out/{n}', 6) for n in self.entries('left_out', '')}
        frames = {n: self.frame(n) for n in self.entries('frames', '/origin')}
        strain = {n: self.strain_point(n) for n in self.entries('strain', '/origin')}
        surface = self.surface()
        self.taken |= {f'surface/{part.name}' for part in fields(Surface)}
        for name in self.arrays:
            if name not in self.taken:
                self.fail(name, 'be one that a link file has', 'it')
        if self.findings:
            return None
        assert mass is not None
        none = np.zeros(0)
        return ReducedLink(
            mass=float(mass),
            com=parts[0],  # type: ignore[arg-type]
            inertia=parts[1],  # type: ignore[arg-type]
            points=points,  # type: ignore[arg-type]
            stiffness=stiffness,  # type: ignore[arg-type]
            pairs=pairs.astype(np.int64),
            frames=frames,  # type: ignore[arg-type]
            damping=damping,
            damping_ratio=ratio,
            strain=strain,  # type: ignore[arg-type]
            surface=surface,
            frequencies=none if kept is None else kept,
            frequencies_left_out=none if left is None else left,
            left_out=lost,  # type: ignore[arg-type]
            source=source,
        )


def _check(link: ReducedLink, findings: list[str]) -> None:
    """Note everything that no link is: shapes are right."""
    if not 1 <= link.modes <= MOST_MODES:
        findings.append(f'stiffness must have 1 to {MOST_MODES} modes, got {link.modes}')
        return
    if not link.mass > 0.0:
        findings.append(f'mass must be > 0 kg, got {link.mass:g}')
        return
    for name in ('stiffness', 'damping', 'damping_ratio'):
        values = getattr(link, name)
        if values is None:
            continue
        lowest, least = float(values.min()), '> 0' if name == 'stiffness' else '>= 0'
        if lowest < 0.0 or (lowest == 0.0 and name == 'stiffness'):
            findings.append(f'{name} of each mode must be {least}, got {lowest:g}')
    if link.damping is not None and link.damping_ratio is not None:
        findings.append('damping must stand alone or damping_ratio, got both')
    pairs = [(int(j), int(k)) for j, k in link.pairs]
    if any(not 0 <= j <= k < link.modes for j, k in pairs) or len(set(pairs)) < len(pairs):
        rule = f'name pairs of modes 0 <= j <= k < {link.modes}, none twice'
        findings.append(f'quadratic/index must {rule}')
    _check_inertia(link, findings)
    for name, frame in link.frames.items():
        off = float(np.abs(frame.rotation.T @ frame.rotation - np.eye(3)).max())
        if off > UNIT_ROUNDING or np.linalg.det(frame.rotation) < 0.0:
            findings.append(f'rotation of frame {name!r} must be a proper one, got {off:.3g} off')
    for name, point in link.strain.items():
        length = float(np.linalg.norm(point.direction))
        if abs(length - 1.0) > UNIT_ROUNDING:
            findings.append(
                f'direction of strain point {name!r} must be of length 1, got {length:g}'
            )
    modal = link.modal_mass
    if not (modal > 0.0).all():
        which = int(np.argmin(modal)) + 1
        findings.append(
            f'points must give each mode a mass > 0, got {modal.min():g} of mode {which}'
        )


def _check_inertia(link: ReducedLink, findings: list[str]) -> None:
    """Note mass, centre and inertia that the points do not give, or that no body has."""
    rigid = link.points[:, :4]
    second = rigid.T @ rigid  # [[m, int r^T], [., int r r^T]]
    inertia = np.trace(second[1:, 1:]) * np.eye(3) - second[1:, 1:]
    size = math.sqrt(float(np.trace(second[1:, 1:])) / max(second[0, 0], 1e-300))
    rows = (
        ('mass', link.mass, second[0, 0], 'kg', link.mass),
        ('com', link.com, second[0, 1:] / max(second[0, 0], 1e-300), 'm', size),
        ('inertia', link.inertia, inertia, 'kg m^2', link.mass * size**2),
    )
    for name, said, found, unit, scale in rows:
        off = float(np.abs(np.asarray(said) - found).max())
        if not off <= ROUNDING * scale:
            findings.append(f"{name} must be the points', got {off:.3g} {unit} off")
    spread = 0.5 * np.trace(link.inertia) * np.eye(3) - link.inertia
    lowest = float(np.linalg.eigvalsh(spread)[0]) / max(size**2, 1e-300)
    if lowest < -ROUNDING * link.mass:
        findings.append(f'inertia must be one that a body can have, got a mass of {lowest:g} kg')
