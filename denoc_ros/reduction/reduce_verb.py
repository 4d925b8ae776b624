"""`denoc reduce SOURCE -o LINK.npz`: a flexible link from a mesh or other programs' matrices."""

from __future__ import annotations

import argparse
import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from denoc_ros.cli.arguments import (
    add_json,
    add_number,
    add_option,
    add_output,
    add_pairs,
    given_file,
    require,
)
from denoc_ros.cli.progress import seconds, share_bar
from denoc_ros.cli.verb_result import VerbResult
from denoc_ros.cli.verbs import DOUBTFUL
from denoc_ros.errors import ConfigError, ModelError
from denoc_ros.model.beams.beams import warping_doubts
from denoc_ros.model.beams.link_file import write
from denoc_ros.model.reading.mesh_files import SURFACE_FORMATS
from denoc_ros.model.reading.mesh_reader import VOLUME_FORMATS
from denoc_ros.model.reading.poses import pose_of
from denoc_ros.output_files import require_new, whole_file, write_new
from denoc_ros.pages.provenance import named_file, provenance
from denoc_ros.reduction.link_description import LinkDescription, describe_link, with_block
from denoc_ros.reduction.suggest.materials import ASSUMED_DAMPING
from denoc_ros.terminal_text import say
from denoc_ros.text_table import text_table
from denoc_ros.types import Array

if TYPE_CHECKING:  # an optional extra
    from denoc_ros.reduction.reduce_link import Estimate, Frames, ReducedMesh

UNIT_NAMES = ('m', 'cm', 'mm', 'in')
EXTRA = ('pytetwild', 'skfem', 'pymetis', 'meshio')  # packages that only this verb needs
DESCRIPTION = (
    'Make a flexible link of a closed surface mesh (STL, COLLADA, OBJ, PLY, OFF, GLB), a volume '
    'mesh (.msh, .inp, .bdf, .mesh), the link of a URDF (its <beam>, else its mesh), or mass and '
    'stiffness matrices of another program (.mtx, .npz, .op4, .op2, .sti, .full). The file is for '
    '<flexible link= file=>.'
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_option(parser, 'source', 'the mesh, the URDF, or the stiffness matrix')
    add_output(
        parser,
        '',
        "the link's file, .npz; of a URDF also .urdf: the robot with the link, and the file "
        'beside it',
        required=True,
    )
    add_option(parser, '--link NAME', 'link of the URDF')
    add_option(parser, '--page FILE', 'also write an HTML page on the reduction', type=Path)
    add_json(parser)
    _add_frames(parser)
    _add_material(parser)
    _add_mesh(parser)
    _add_matrices(parser)
    group = parser.add_argument_group('modes')
    add_number(group, '--modes N', 6, 'modes', '', 1, 64)
    add_number(
        group, '--damping RATIO', ASSUMED_DAMPING, 'damping ratio of each', '', 0.0, below=1.0
    )
    text = 'a mass at a frame that the modes are those of'
    add_pairs(group, '--tip-mass NAME=KG', text, float)
    text = 'a strain gauge: place on the surface [m] and direction'
    add_pairs(group, '--gauge NAME=X,Y,Z,DX,DY,DZ', text, _numbers(6))
    add_option(
        group,
        '--quadratic',
        'second-order displacement: modal derivatives (default; matrices have none), '
        'foreshortening of the line from root to tip, or none',
        'derivatives',
        choices=('derivatives', 'line', 'none'),
    )


def _add_frames(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group('frames, in the link frame, which is the clamped root')
    add_option(group, '--frames URDF:LINK', "frames of the link's joints, and its mass")
    add_pairs(group, '--frame NAME=X,Y,Z', 'another frame at a place [m]', _numbers(3))
    add_option(
        group,
        '--radius [NAME=]R',
        "radius of the rigid patch of a frame, root for the link frame's, or of all [m]; "
        'default: the plane face that the frame is on, else as far as the surface',
        [],
    )


def _add_material(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group('material of a mesh')
    add_option(group, '--material NAME', 'aluminium, steel, titanium, magnesium, cfrp or gfrp')
    for name, unit, text in (
        ('young', 'PA', "Young's modulus"),
        ('poisson', 'NU', "Poisson's ratio"),
        ('density', 'KG/M^3', 'density'),
    ):
        group.add_argument(
            f'--{name}', type=float, metavar=unit, help=f"{text} in place of the material's"
        )
    add_option(
        group,
        '--mass',
        "keep the density (default), or scale it to the URDF's mass of the link",
        'keep',
        choices=('keep', 'scale'),
    )


def _add_mesh(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group('mesh')
    add_option(group, '--units', 'units of the mesh; a URDF says its own', choices=UNIT_NAMES)
    text = 'metres per unit of the mesh'
    add_number(group, '--scale S', float, text, positive=True, finite=True)
    add_option(
        group,
        '--edge L',
        "length of the tetrahedra's edges [m]; default: by the thickness of the wall",
        type=float,
    )
    add_option(group, '--close', 'take a surface with holes: the mesher fills them')
    add_option(group, '--no-coarser', 'leave out the comparison with a coarser mesh')


def _add_matrices(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("another program's matrices, in SI unless --scale says else")
    add_option(group, '--mass-matrix FILE', 'mass matrix; default: of the source')
    add_option(group, '--nodes FILE', 'nodes: a table of number, x, y, z, or an input file')


def run(args: argparse.Namespace) -> VerbResult:
    """Reduce the source and write the link; exit status 2 with doubts; errors are raised."""
    _check_extra()
    source = given_file(args.source, 'source')
    described = _described(args, source)
    frames = _frames(args, described)
    files = _outputs(args, source)
    require_new(*files, args.page)
    found = _reduced(args, source, described, frames)
    return _finish(args, source, described, found, files)


def _check_extra() -> None:
    for name in EXTRA:
        if importlib.util.find_spec(name) is None:
            rule = "must be installed: pip install 'denoc_ros[reduce]'"
            raise ConfigError('denoc reduce', [f'{name} {rule}, got none'])


def _described(args: argparse.Namespace, source: Path) -> LinkDescription | None:
    if source.suffix == '.urdf':
        require([] if args.link else ['--link must be given with a URDF, got none'])
        require(['--frames must come with a mesh, got a URDF'] if args.frames else [])
        return describe_link(source, args.link)
    require(['--link must come with a URDF, got a mesh'] if args.link else [])
    if not args.frames:
        return None
    file, colon, link = args.frames.rpartition(':')
    require([] if colon and file and link else [f'--frames must be URDF:LINK, got {args.frames}'])
    return describe_link(given_file(file, 'robot'), link)


def _numbers(count: int) -> Any:
    def read(text: str) -> Array:
        values = np.array([float(part) for part in text.split(',')])
        if len(values) != count or not np.isfinite(values).all():
            raise ValueError(text)
        return values

    return read


def _frames(args: argparse.Namespace, described: LinkDescription | None) -> Frames:
    from denoc_ros.reduction.reduce_link import Frames

    findings: list[str] = []
    outer = {} if described is None else dict(described.frames)
    outer |= {name: pose_of(place) for name, place in args.frame.items()}
    if not outer and (described is None or described.beam is None):
        findings.append('a frame besides the root must be given: --frames or --frame, got none')
    radii = {}
    for text in args.radius:
        name, equals, size = text.rpartition('=')
        try:
            radii[name if equals else '*'] = float(size)
        except ValueError:
            findings.append(f'--radius must be R or NAME=R, got {text!r}')
    for name, radius in radii.items():
        if not 0.0 < radius < np.inf:
            findings.append(f'--radius must be > 0 m, got {radius:g}')
        if name not in ('*', 'root', *outer):
            findings.append(f'--radius must name root or {", ".join(outer)}, got {name!r}')
    if args.scale is not None and args.units is not None:
        findings.append('--scale must come without --units, got both')
    require(findings)
    return Frames(outer, {'' if n == 'root' else n: r for n, r in radii.items()})


def _outputs(args: argparse.Namespace, source: Path) -> list[Path]:
    """Return the link's file, and that of the robot where one is wanted."""
    if args.output.suffix == '.npz':
        return [args.output]
    if args.output.suffix == '.urdf' and source.suffix == '.urdf':
        return [args.output.with_name(f'{args.link}.npz'), args.output]
    require([f'--output must end in .npz, or in .urdf for a URDF, got {args.output.name}'])
    raise AssertionError


def _wishes(args: argparse.Namespace, described: LinkDescription | None, frames: Frames) -> Any:
    from denoc_ros.reduction.link import Wishes

    findings: list[str] = []
    for name, mass in args.tip_mass.items():
        if name not in frames.outer:
            findings.append(f'--tip-mass must name {", ".join(frames.outer)}, got {name!r}')
        if not 0.0 <= mass < float('inf'):
            findings.append(f'--tip-mass must be >= 0 kg, got {mass:g}')
    for name, values in args.gauge.items():
        if not values[3:].any():
            findings.append(f'--gauge {name} must have a direction that is not zero')
    require(findings)
    gauges = {} if described is None else dict(described.gauges)
    return Wishes(
        modes=args.modes,
        damping_ratio=args.damping,
        tip_mass=args.tip_mass,
        gauges=gauges | {name: (at[:3], at[3:]) for name, at in args.gauge.items()},
        quadratic=args.quadratic,
    )


def _reduced(
    args: argparse.Namespace, source: Path, described: LinkDescription | None, frames: Frames
) -> ReducedMesh:
    """Reduce the source, whatever it is."""
    from denoc_ros.reduction import mesh
    from denoc_ros.reduction.coupled_beam import reduce_beam
    from denoc_ros.reduction.formats import matrices
    from denoc_ros.reduction.reduce_link import (
        ReducedMesh,
        elasticity_of,
        reduce_matrices,
        reduce_solid,
        reduce_surface,
    )

    wishes = _wishes(args, described, frames)
    suffix = source.suffix.lower()
    known = (*SURFACE_FORMATS, *VOLUME_FORMATS, *matrices.FORMATS, '.urdf')
    require([] if suffix in known else [f'source must end in {", ".join(known)}, got {suffix!r}'])
    with share_bar(args.json) as bar:
        options: dict[str, Any] = {
            'told': lambda estimate: _tell(estimate, args.json),
            'report': lambda share: bar.update(share - bar.n),
        }
        if suffix in matrices.FORMATS and not (suffix == '.npz' and args.material):
            body = matrices.read_matrices(source, args.mass_matrix, args.nodes, _scale(args, 1.0))
            found = reduce_matrices(body, frames, wishes, source.name, **options)
            return ReducedMesh(found, np.zeros(0), 0, tuple(found.doubts))
        if described is not None and source.suffix == '.urdf' and described.beam is not None:
            said = f'{source.name}, beam of {described.link}'
            beam = reduce_beam(
                described.beam, described.inertia, frames.outer, wishes, said, options['report']
            )
            doubts = (*warping_doubts(described.beam), *beam.doubts)
            return ReducedMesh(beam, np.zeros(0), 0, doubts)
        elasticity, said = elasticity_of(args.material, args.young, args.poisson, args.density)
        mass = _target_mass(args, described)
        if suffix in VOLUME_FORMATS:
            solid = mesh.read_volume(source, np.eye(4), _scale(args), elasticity)
            text = f'{source.name}, {said}'
            found = reduce_solid(solid, frames, wishes, text, mass, **options)
            return ReducedMesh(found, np.zeros(0), 0, tuple(found.doubts))
        surface = _surface(args, source, described)
        return reduce_surface(
            surface,
            elasticity,
            frames,
            wishes,
            f'{Path(surface.where).name}, {said}',
            args.edge,
            mass,
            not args.no_coarser,
            **options,
        )


def _scale(args: argparse.Namespace, default: float | None = None) -> float:
    """Return the metres per unit that the arguments say."""
    from denoc_ros.reduction.mesh import UNITS

    if args.scale is not None:
        return float(args.scale)
    if args.units is not None:
        return UNITS[args.units]
    require([] if default else ['--units or --scale must be given: a mesh says none, got neither'])
    assert default is not None
    return default


def _surface(args: argparse.Namespace, source: Path, described: LinkDescription | None) -> Any:
    """Return the surface: the source's, or the first closed mesh of the URDF's link."""
    from denoc_ros.reduction.mesh import closed_surface

    if described is None or source.suffix != '.urdf':
        return closed_surface(source, np.eye(4), np.full(3, _scale(args)), args.close)
    if not described.meshes:
        got = f'{described.lost[0]!r}, which is not found' if described.lost else 'none'
        rule = f'link {described.link!r} must have a mesh'
        raise ModelError(described.where, [f'{rule}, got {got}'])
    scale = _scale(args, 1.0)
    refused: ModelError | None = None
    for file, pose, factor in described.meshes:
        try:
            return closed_surface(file, pose, scale * factor, False)
        except ModelError as error:
            refused = refused or error
    if not args.close:
        assert refused is not None
        raise refused
    file, pose, factor = described.meshes[0]
    return closed_surface(file, pose, scale * factor, True)


def _target_mass(args: argparse.Namespace, described: LinkDescription | None) -> float | None:
    """Return the mass that the density is scaled to, None for the material's own."""
    if args.mass == 'keep':
        return None
    inertia = None if described is None else described.inertia
    has = inertia is not None and inertia.mass > 0.0
    require([] if has else ["--mass scale must come with a URDF's mass of the link, got none"])
    assert inertia is not None
    return inertia.mass


def _tell(estimate: Estimate, quiet: bool) -> None:
    if not quiet:
        said = f'about {seconds(max(estimate.seconds, 1.0))}, {estimate.megabytes:.0f} MB'
        say(f'{estimate.nodes} nodes: {said}', file=sys.stderr)


def _finish(
    args: argparse.Namespace,
    source: Path,
    described: LinkDescription | None,
    found: ReducedMesh,
    files: list[Path],
) -> VerbResult:
    """Write the result; exit status 2 with doubts."""
    from denoc_ros.reduction.reduce_page import page, summary

    of_beam = described is not None and described.beam is not None and len(files) > 1
    row = summary(found, None if described is None or of_beam else described.inertia)
    row['output'] = str(files[0])
    name = described.link if described is not None else (args.link or source.stem)
    inertial = 'urdf' if of_beam else 'file'
    row['block'] = f'<flexible link="{name}" file="{files[0].name}" inertial="{inertial}"/>'
    with whole_file(files[0]) as unfinished:
        write(unfinished, found.reduction.link)
    if len(files) > 1:
        assert described is not None
        write_new(files[1], with_block(source, described, files[0].name))
        row['robot'] = str(files[1])
    if args.page:
        origin = provenance(args.command, {'source': named_file(source)})
        with whole_file(args.page) as unfinished:
            html = page(found, row, name, origin).html()
            unfinished.write_text(html, encoding='utf-8')
    notes = [f'denoc reduce: warning: {doubt}' for doubt in row['doubts']]
    return VerbResult(row, _lines(row), DOUBTFUL if row['doubtful'] else 0, notes)


def _lines(row: dict[str, Any]) -> Iterator[str]:
    said = f'{row["mass_kg"]:.4g} kg'
    if row['urdf_mass_kg'] is not None:
        said += f' (URDF: {row["urdf_mass_kg"]:.4g} kg)'
    modes, points = len(row['frequencies_hz']), row['points']
    yield f'{row["source"]}\n{said}, {modes} modes, {points} points'
    yield '\nmodes, root clamped\n' + text_table(row['modes'])
    yield '\nframes: static compliance, and what the modes lack of it\n' + text_table(
        row['frames']
    )
    yield '\npatches\n' + text_table(row['patches'])
    yield f'\n{row["output"]}: written; in <flexibility>:\n  {row["block"]}'
    if 'robot' in row:
        yield f'{row["robot"]}: written'
