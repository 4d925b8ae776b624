"""Mass and stiffness matrices of other programs, with their nodes.

`.npz`: ours, with `nodes` (n, 3), and `stiffness` and `mass`, dense or as `stiffness/row`,
`stiffness/column`, `stiffness/value`; rows are x, y, z of each node, or six of each node.
`.mtx`: MatrixMarket (Ansys writes it: `*EXPORT, …, MMF`), rows as before; or Abaqus' `*MATRIX
GENERATE`, which says node and direction of each entry.
`.sti`, `.mas`, `.dof`: CalculiX, `*FREQUENCY, SOLVER=MATRIXSTORAGE`.
`.op4`: Nastran, by pyyeti; rows are six of each node, in the order of the nodes' numbers, or the
rows that an `.op2` file with the nodes says.
`.op2`: Nastran, matrices and nodes in one file.
`.full`: Ansys, by ansys-mapdl-reader; nodes in an `.rst` file or a table.

Numbers only are read: nothing in a file is ever executed.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
import scipy.sparse as sparse
from numpy.typing import NDArray

from denoc_ros.child_arrays import arrays_of
from denoc_ros.decompression import require_bounded_archive
from denoc_ros.errors import ModelError
from denoc_ros.reduction.body import FiniteElementBody
from denoc_ros.types import Array

FORMATS = ('.npz', '.mtx', '.sti', '.op4', '.op2', '.full')
MOST_BYTES = 4 << 30  # of a file, or of the arrays of an archive
MARKET = b'%%MatrixMarket'
Rows = NDArray[np.int64]


@dataclass(frozen=True)
class _Nodes:
    """Numbers (n,) and places (n, 3) of nodes."""

    numbers: Rows
    places: Array


def read_matrices(
    stiffness: Path, mass: str | None, nodes: str | None, scale: float = 1.0
) -> FiniteElementBody:
    """Read a body from matrices, in the link frame.

    Parameters
    ----------
    stiffness : Path
        The stiffness matrix, or an archive with all.
    mass, nodes : str, optional
        Files with the mass matrix and the nodes; default: those beside the first, or in it.
    scale : float
        Metres per unit of length of the file, whose forces are in N and times in s: of a file in
        mm, N and s the stiffness is in N/mm and the mass in t.

    Raises
    ------
    ModelError
        For what a file lacks, and for what is no matrix.
    """
    suffix = stiffness.suffix.lower()
    reader: dict[str, Callable[..., FiniteElementBody]] = {
        '.npz': _read_archive,
        '.mtx': _read_text,
        '.sti': _read_calculix,
        '.op4': _read_nastran,
        '.op2': _read_nastran,
        '.full': _read_ansys,
    }
    for file in (stiffness, *(Path(name) for name in (mass, nodes) if name)):
        if not file.is_file():
            raise ModelError(str(file), ['the file must exist, got none of this name'])
        if file.stat().st_size > MOST_BYTES:
            got = f'{file.stat().st_size / 2**30:.1f}'
            raise ModelError(str(file), [f'the file must have at most 4 GB, got {got}'])
    body = reader[suffix](stiffness, mass and Path(mass), nodes and Path(nodes))
    return body if scale == 1.0 else _scaled(body, scale)


def _scaled(body: FiniteElementBody, scale: float) -> FiniteElementBody:
    """Return a body whose lengths are scaled to metres, forces in N and times in s as they are.

    Mass is force times time squared over length: kg = t * 1000 for mm.
    """
    inverse = sparse.diags_array(np.where(body.dof_axes < 3, 1.0 / scale, 1.0))
    # energies are forces times lengths: scaled too
    stiffness = scale * (inverse @ body.stiffness @ inverse)
    mass = scale * (inverse @ body.mass @ inverse)
    return FiniteElementBody(
        body.where,
        scale * body.nodes,
        stiffness.tocsr(),
        mass.tocsr(),
        body.dof_nodes,
        body.dof_axes,
    )


def _lacks(file: Path, what: str, way: str) -> ModelError:
    return ModelError(str(file), [f'{what} must be given, got none: {way}'])


def _whole(where: str, nodes: Array, stiffness: Any, mass: Any) -> FiniteElementBody:
    """Return a body whose rows are three or six per node, node by node."""
    count, size = len(nodes), stiffness.shape[0]
    for per in (3, 6):
        if size == per * count:
            rows = np.arange(size)
            return _trimmed(
                FiniteElementBody(where, nodes, stiffness, mass, rows // per, rows % per)
            )
    rule = f'stiffness must have 3 or 6 rows for each of {count} nodes'
    raise ModelError(where, [f'{rule}, got {size}'])


def _trimmed(body: FiniteElementBody) -> FiniteElementBody:
    """Return a body without turns that have no stiffness, as solids of six rows per node have."""
    body = _as_csr(body)
    if body.stiffness.shape != body.mass.shape:
        body.check()
    held = (body.dof_axes < 3) | (np.asarray(abs(body.stiffness).sum(axis=1)).ravel() > 0.0)
    kept = np.flatnonzero(held)
    return FiniteElementBody(
        body.where,
        body.nodes,
        body.stiffness[kept][:, kept],
        body.mass[kept][:, kept],
        body.dof_nodes[kept],
        body.dof_axes[kept],
    )


def _as_csr(body: FiniteElementBody) -> FiniteElementBody:
    stiffness, mass = (sparse.csr_matrix(m, dtype=np.float64) for m in (body.stiffness, body.mass))
    return FiniteElementBody(
        body.where, body.nodes, stiffness, mass, body.dof_nodes, body.dof_axes
    )


def _read_archive(file: Path, mass: Path | None, nodes: Path | None) -> FiniteElementBody:
    arrays = _arrays(file)
    places = _node_table(nodes).places if nodes else arrays.get('nodes')
    if places is None:
        raise _lacks(file, "array 'nodes' (n, 3)", 'add it, or --nodes FILE')
    if places.ndim != 2 or places.shape[1] != 3 or places.dtype.kind not in 'fiu':
        raise ModelError(str(file), [f"array 'nodes' must be (n, 3), got {places.shape}"])
    matrices = []
    for name in ('stiffness', 'mass'):
        source, held = (mass, _arrays(mass)) if name == 'mass' and mass else (file, arrays)
        matrices.append(_matrix(source, held, name))
    return _whole(str(file), np.asarray(places, dtype=np.float64), *matrices)


def _arrays(file: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of an archive; ModelError for one that is torn, too large or pickled."""
    where = str(file)
    try:
        require_bounded_archive(file, MOST_BYTES)
        with np.load(file, allow_pickle=False) as held:
            return {name: held[name] for name in held.files}
    except (zipfile.BadZipFile, ValueError, EOFError, OSError, KeyError, MemoryError) as error:
        got = str(error).splitlines()[0] if str(error) else 'less'
        raise ModelError(where, [f'file must be a whole .npz of numbers, got: {got}']) from error


def _matrix(file: Path, arrays: dict[str, NDArray[Any]], name: str) -> Any:
    """Return a matrix of an archive: dense, as triples, or as `scipy.sparse.save_npz` has it."""
    try:
        if name in arrays:
            return sparse.csr_matrix(np.asarray(arrays[name], dtype=np.float64))
        if f'{name}/value' in arrays:
            triple = (arrays[f'{name}/{part}'] for part in ('value', 'row', 'column'))
            value, row, column = (part.ravel() for part in triple)
            return sparse.coo_matrix((value.astype(np.float64), (row, column))).tocsr()
        if {'indptr', 'indices', 'data', 'shape'} <= set(arrays):
            kinds = {'csr': sparse.csr_matrix, 'csc': sparse.csc_matrix}
            kind = kinds[np.asarray(arrays.get('format', 'csr')).item().decode()]
            parts = (arrays['data'], arrays['indices'], arrays['indptr'])
            return kind(parts, shape=tuple(arrays['shape'])).tocsr()
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ModelError(str(file), [f'{name} must be a sparse matrix, got: {error}']) from error
    way = f"add the array '{name}'" + ('' if name == 'stiffness' else ', or --mass-matrix FILE')
    raise _lacks(file, f'{name} matrix', way)


def _read_text(file: Path, mass: Path | None, nodes: Path | None) -> FiniteElementBody:
    if mass is None:
        raise _lacks(file, 'mass matrix', '--mass-matrix FILE')
    if nodes is None:
        raise _lacks(file, 'nodes', '--nodes FILE with number, x, y, z, or the input file')
    table = _node_table(nodes)
    with file.open('rb') as opened:
        if opened.read(len(MARKET)) == MARKET:
            return _whole(str(file), table.places, _market(file), _market(mass))
    return _read_abaqus(file, mass, table)


def _market(file: Path) -> Any:
    try:
        return sparse.csr_matrix(scipy.io.mmread(file), dtype=np.float64)
    except (ValueError, TypeError, OSError, EOFError, OverflowError) as error:
        rule = 'the file must be a whole MatrixMarket matrix'
        raise ModelError(str(file), [f'{rule}, got: {error}']) from error


def _read_abaqus(file: Path, mass: Path, table: _Nodes) -> FiniteElementBody:
    """Return a body of node, direction, node, direction, value; one triangle of each matrix."""
    entries = [_table(each, 5) for each in (file, mass)]
    ends = np.vstack([e[:, part] for e in entries for part in (slice(0, 2), slice(2, 4))])
    keys = [(int(node), int(direction)) for node, direction in np.unique(ends, axis=0)]
    row = {key: k for k, key in enumerate(keys)}
    both = []
    for e in entries:
        first = [row[int(n), int(d)] for n, d in e[:, :2]]
        second = [row[int(n), int(d)] for n, d in e[:, 2:4]]
        both.append(_both_triangles(np.array(first), np.array(second), e[:, 4], len(keys)))
    return _keyed(file, file, table, keys, both)


def _keyed(
    file: Path, keyed: Path, table: _Nodes, keys: Sequence[tuple[int, int]], both: Sequence[Any]
) -> FiniteElementBody:
    """Return a body of stiffness and mass whose rows are (number of a node, direction 1 to 6)."""
    order = {int(number): k for k, number in enumerate(table.numbers)}
    unknown = [node for node, _ in keys if node not in order]
    if unknown:
        rule = 'each node must be in the table of nodes'
        raise ModelError(str(keyed), [f'{rule}, got node {unknown[0]}, which is not'])
    if any(not 1 <= direction <= 6 for _, direction in keys):
        raise ModelError(str(keyed), ['directions must be 1 to 6, got others'])
    used = sorted({node for node, _ in keys}, key=order.__getitem__)
    place = {node: k for k, node in enumerate(used)}
    return _trimmed(
        FiniteElementBody(
            str(file),
            table.places[[order[node] for node in used]],
            both[0],
            both[1],
            np.array([place[node] for node, _ in keys], dtype=np.int64),
            np.array([direction - 1 for _, direction in keys], dtype=np.int64),
        )
    )


def _both_triangles(row: Rows, column: Rows, value: Array, size: int) -> Any:
    """Return a symmetric matrix from one triangle, or from both as they stand."""
    matrix = sparse.coo_matrix((value, (row, column)), shape=(size, size)).tocsr()
    if (row > column).any() and (row < column).any():
        mirrored = sparse.coo_matrix((value, (column, row)), shape=(size, size)).tocsr()
        if abs(matrix - mirrored).max() <= 1e-6 * abs(matrix).max():
            return matrix
    return matrix + matrix.T - sparse.diags_array(matrix.diagonal(), format='csr')


def _read_calculix(file: Path, mass: Path | None, nodes: Path | None) -> FiniteElementBody:
    mass = mass or file.with_suffix('.mas')
    directions = file.with_suffix('.dof')
    for each, what in ((mass, 'mass matrix'), (directions, 'list of rows')):
        if not each.is_file():
            raise _lacks(file, what, f'{each.name} must stand beside it')
    nodes = nodes or file.with_suffix('.inp')
    if not nodes.is_file():
        raise _lacks(file, 'nodes', '--nodes FILE with number, x, y, z, or the input file')
    table = _node_table(nodes)
    try:
        text = directions.read_text(encoding='ascii').split()
        pairs = [(int(each.split('.')[0]), int(each.split('.')[1])) for each in text]
    except (ValueError, IndexError) as error:
        rule = 'each line must be NODE.DIRECTION'
        raise ModelError(str(directions), [f'{rule}, got: {error}']) from error
    both, size = [], len(pairs)
    for each in (file, mass):
        entries = _table(each, 3)
        row, column = (entries[:, k].astype(np.int64) - 1 for k in (0, 1))
        if entries[:, :2].min() < 1 or entries[:, :2].max() > size:
            rule = f'rows must be 1 to {size}, those of {directions.name}'
            raise ModelError(str(each), [f'{rule}, got others'])
        both.append(_both_triangles(row, column, entries[:, 2], size))
    return _keyed(file, directions, table, pairs, both)


def _read_nastran(file: Path, mass: Path | None, nodes: Path | None) -> FiniteElementBody:
    nodes = nodes or (file if file.suffix.lower() == '.op2' else None)
    if nodes is None:
        raise _lacks(file, 'nodes', '--nodes FILE with number, x, y, z, or an .op2 file')
    found = _nastran_matrices(file)
    if mass is not None:
        found |= _nastran_matrices(mass)
    both = [found[name]() for name in _pair(file, list(found))]
    if nodes.suffix.lower() == '.op2':
        return _of_sets(file, nodes, both)
    table = _node_table(nodes)
    order = np.argsort(table.numbers)
    return _whole(str(file), table.places[order], *both)


def _pair(file: Path, names: Sequence[str]) -> list[str]:
    """Return the names of stiffness and mass: of all rows, of the analysis set, the only ones."""
    of = {name.upper(): name for name in names}
    for rows in ('GG', 'AA'):
        if {f'K{rows}', f'M{rows}'} <= set(of):
            return [of[f'K{rows}'], of[f'M{rows}']]
    pair = []
    for name, first in (('stiffness', 'K'), ('mass', 'M')):
        starting = [each for each in names if each.upper().startswith(first)]
        if len(starting) != 1:
            rule = f'one matrix must be the {name}, named {first}…'
            raise ModelError(str(file), [f'{rule}, got {", ".join(names) or "none"}'])
        pair += starting
    return pair


def _nastran_matrices(file: Path) -> dict[str, Callable[[], Any]]:
    """Return the readers of a file's matrices by name."""
    if file.suffix.lower() == '.op2':
        sizes = _output2(file, _output2_sizes, 'a whole output2 file')
        return {name: partial(_output2_matrix, file, name, size) for name, size in sizes.items()}
    try:
        from pyyeti.nastran import op4
    except ImportError as error:
        raise _no_reader(file, 'Nastran', 'pyyeti', 'nastran', error) from error
    try:
        found = op4.read(str(file), sparse=True)
    except Exception as error:  # torn files end in errors of many kinds
        got = str(error) or type(error).__name__
        rule = 'the file must be a whole output4 file'
        raise ModelError(str(file), [f'{rule}, got: {got}']) from error
    return {str(name): partial(_real, file, name, matrix) for name, matrix in found.items()}


def _output2_sizes(opened: Any) -> dict[str, tuple[int, int]]:
    """Return the numbers of rows and columns of an output2 file's matrices."""
    return {
        name: blocks[-1].size for name, blocks in opened.dbdct.items() if blocks[-1].dbtype == 1
    }


def _output2_matrix(file: Path, name: str, size: tuple[int, int]) -> Any:
    # the reader makes a dense matrix of it
    if 8 * size[0] * size[1] > MOST_BYTES:
        most = int(np.sqrt(MOST_BYTES / 8))
        rule = f'matrix {name} must have at most {most} rows in an output2 file'
        way = 'write it by OUTPUT4, which is read as it is'
        raise ModelError(str(file), [f'{rule}, got {size[0]} x {size[1]}: {way}'])
    found = _output2(file, lambda opened: opened.rdop2mats([name]), f'whole matrix {name}')
    return _real(file, name, found[name])


def _real(file: Path, name: str, matrix: Any) -> Any:
    if np.iscomplexobj(matrix):
        raise ModelError(str(file), [f'matrix {name} must be real, got complex numbers'])
    return sparse.csr_matrix(matrix, dtype=np.float64)


def _output2(file: Path, read: Callable[[Any], Any], what: str) -> Any:
    """Return the result of a reader of an output2 file."""
    try:
        from pyyeti.nastran import op2
    except ImportError as error:
        raise _no_reader(file, 'Nastran', 'pyyeti', 'nastran', error) from error
    try:
        with contextlib.redirect_stdout(io.StringIO()), op2.OP2(str(file)) as opened:
            return read(opened)
    except Exception as error:  # torn files end in errors of many kinds
        got = str(error) or type(error).__name__
        raise ModelError(str(file), [f'the file must be {what}, got: {got}']) from error


def _sets(opened: Any) -> tuple[Any, Any]:
    """Return the table of rows, and which are of the analysis set."""
    from pyyeti.nastran import n2p

    sets = opened.rdn2cop2()['uset']
    uset = sets[0] if 0 in sets else next(iter(sets.values()))
    return uset, np.asarray(n2p.mksetpv(uset, 'p', 'a'))


def _of_sets(file: Path, nodes: Path, both: Sequence[Any]) -> FiniteElementBody:
    """Return a body whose nodes, and the rows of its analysis set, an output2 file says."""
    uset, analysis = _output2(nodes, _sets, 'an output2 file with BGPDT, EQEXIN and USET')
    values = uset[['x', 'y', 'z']].to_numpy(dtype=np.float64)
    names = uset.index.get_level_values('id').to_numpy(dtype=np.int64)
    directions = uset.index.get_level_values('dof').to_numpy(dtype=np.int64)
    size = both[0].shape[0]
    kept = np.full(len(uset), True) if size == len(uset) else analysis
    if size != kept.sum():
        rule = f'matrices must have {len(uset)} rows (g-set) or {int(analysis.sum())} (a-set)'
        raise ModelError(str(file), [f'{rule} as {nodes.name} says, got {size}'])
    if (directions[kept] == 0).any():
        rule = 'rows must be of nodes alone'
        count = int((directions[kept] == 0).sum())
        raise ModelError(str(file), [f'{rule}, got {count} of scalar points'])
    first = np.flatnonzero(directions == 1)
    # the second row of a node has its output coordinate system: number, type
    systems = values[first + 1, 0]
    if systems.any():
        rule = "displacements must be in the basic system (GRID's CD empty)"
        at = int(names[first][np.flatnonzero(systems)[0]])
        raise ModelError(str(nodes), [f'{rule}, got node {at} in another'])
    table = _Nodes(names[first], values[first])
    keys = list(zip(names[kept].tolist(), directions[kept].tolist(), strict=True))
    return _keyed(file, file, table, keys, both)


def _no_reader(
    file: Path, program: str, package: str, extra: str, got: object = 'no such package'
) -> ModelError:
    rule = f"{program}'s files must be read with {package}: pip install 'denoc_ros[{extra}]'"
    return ModelError(str(file), [f'{rule}, got: {got}'])


def _read_ansys(file: Path, mass: Path | None, nodes: Path | None) -> FiniteElementBody:
    if mass is not None:
        raise ModelError(str(file), ['--mass-matrix must be left out: a .full file has both'])
    if nodes is None:
        raise _lacks(file, 'nodes', '--nodes FILE.rst, or with number, x, y, z')
    keys, both, constrained = ansys_matrices(file)
    if constrained:
        rule = 'matrices must have no constraint'
        got = f'{constrained} constrained rows, which Ansys leaves out'
        raise ModelError(str(file), [f'{rule}, got {got}: write it without displacement loads'])
    if nodes.suffix.lower() == '.rst':
        mesh = _ansys_arrays(nodes, 'a result file with its mesh')
        table = _Nodes(mesh['numbers'], mesh['places'])
    else:
        table = _node_table(nodes)
    return _keyed(file, file, table, keys, both)


def ansys_matrices(file: Path) -> tuple[list[tuple[int, int]], list[Any], int]:
    """Return the rows, stiffness and mass of Ansys' `.full` file, and how many are constrained.

    Rows are (number of a node, direction 1 to 6); those constrained are zero.
    """
    found = _ansys_arrays(file, 'a .full file of a structure with stiffness and mass')
    findings = [
        f'{name} must be in the file, got none: MODOPT and PSOLVE write both'
        for name in ('stiffness', 'mass')
        if f'{name}/value' not in found
    ]
    ModelError.raise_any(str(file), findings)
    rows, both = found['rows'], []
    for name in ('stiffness', 'mass'):
        row, column, value = (found[f'{name}/{key}'] for key in ('row', 'column', 'value'))
        upper = sparse.coo_matrix((value, (row, column)), shape=(len(rows), len(rows)))
        both.append(sparse.csr_matrix(upper + sparse.triu(upper, 1).T))
    keys = [(int(node), int(axis) + 1) for node, axis in rows]
    return keys, both, int(found['constrained'])


def _ansys_arrays(file: Path, what: str) -> dict[str, Any]:
    """Return the numbers of Ansys' file."""
    try:
        known = importlib.util.find_spec('ansys.mapdl.reader')
    except ImportError:
        known = None
    if known is None:
        raise _no_reader(file, 'Ansys', 'ansys-mapdl-reader', 'ansys')
    script = str(Path(__file__).with_name('ansys_reader.py'))
    return arrays_of(script, file, str(file), f'the file must be {what}')


def _table(file: Path, columns: int) -> Array:
    """Return numbers of a text, a row per line; comments begin with * or #."""
    try:
        rows = [
            [float(part) for part in line.replace(',', ' ').split()]
            for line in file.read_text(encoding='ascii').splitlines()
            if line.strip() and line.lstrip()[0] not in '*#'
        ]
        table = np.array([row[:columns] for row in rows if len(row) >= columns])
    except (ValueError, OSError) as error:
        rule = f'the file must have lines of {columns} numbers'
        raise ModelError(str(file), [f'{rule}, got: {error}']) from error
    short = sum(len(row) < columns for row in rows)
    if short or not len(rows):
        rule = f'each line must have {columns} numbers'
        got = f'{short} shorter ones' if rows else 'no lines'
        raise ModelError(str(file), [f'{rule}, got {got}'])
    return table


def _node_table(file: Path) -> _Nodes:
    """Return nodes from a table of number, x, y, z, or from `*NODE` of an input file."""
    if file.suffix.lower() == '.inp':
        inside, lines = False, []
        for line in file.read_text(encoding='latin-1').splitlines():
            if line.startswith('*'):
                word = line.split(',')[0].strip().upper()
                inside = word == '*NODE' or (inside and line.startswith('**'))
            elif inside and line.strip():
                lines.append(line)
        try:
            table = np.array([[float(p) for p in line.split(',')[:4]] for line in lines])
        except ValueError as error:
            rule = 'lines of *NODE must be number, x, y, z'
            raise ModelError(str(file), [f'{rule}, got: {error}']) from error
    else:
        table = _table(file, 4)
    if table.ndim != 2 or table.shape[1] != 4 or not np.isfinite(table).all():
        raise ModelError(str(file), ['nodes must be number, x, y, z each, got others'])
    numbers = table[:, 0].astype(np.int64)
    if len(np.unique(numbers)) < len(numbers):
        raise ModelError(str(file), ['numbers of nodes must differ, got one twice'])
    return _Nodes(numbers, table[:, 1:])
