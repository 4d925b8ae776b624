"""Matrices in Nastran's and Ansys' own files.

The `.op2` files are of pyyeti's wheel (BSD-3-Clause), `file.full` and `file.rst` of
ansys-mapdl-reader's (MIT): a bar of 40 bricks, clamped in the first and free in the second.
"""

from __future__ import annotations

import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyyeti
from ansys.mapdl import reader
from ansys.mapdl.reader import examples
from pyyeti.nastran import op4
from scipy.linalg import eigh

from denoc_ros.errors import ModelError
from denoc_ros.model.beams.cross_sections import rectangle_torsion_constant
from denoc_ros.reduction.formats import matrices
from denoc_ros.reduction.formats.matrices import ansys_matrices, read_matrices
from denoc_ros.types import Array

NASTRAN = Path(pyyeti.__file__).parent / 'tests'
TWO_NODES = NASTRAN / 'nas2cam' / 'no_se_nas2cam.op2'
REDUCED = NASTRAN / 'nas2cam_extseout'  # a superelement with ten scalar points


def pair(size: int) -> dict[str, Array]:
    loose = np.random.default_rng(1).standard_normal((size, size))
    return {'kaa': loose @ loose.T, 'maa': np.eye(size)}


def test_nodes_and_rows_of_an_output2_file_are_those_of_a_table(tmp_path: Path) -> None:
    op4.write(str(tmp_path / 'both.op4'), pair(12))
    (tmp_path / 'nodes.txt').write_text('1 0 0 0\n2 0.07874 0 0\n')
    found = read_matrices(tmp_path / 'both.op4', None, str(TWO_NODES))
    table = read_matrices(tmp_path / 'both.op4', None, str(tmp_path / 'nodes.txt'))
    assert found.nodes == pytest.approx(table.nodes, abs=1e-7)
    assert abs(found.stiffness - table.stiffness).max() == 0.0
    assert (found.dof_nodes == table.dof_nodes).all()
    assert (found.dof_axes == table.dof_axes).all()


def words(*numbers: int) -> bytes:
    return b''.join(record(struct.pack('i', number)) for number in numbers)


def record(content: bytes) -> bytes:
    length = struct.pack('i', len(content))
    return length + content + length


def output2_matrix(name: str, matrix: Array, kind: int = 2) -> bytes:
    """Return a data block as Nastran's OUTPUT2 writes it: trailer, then a string per column."""
    rows, columns = matrix.shape
    called = name.ljust(8).encode()
    trailer = struct.pack('7i', 101, columns, rows, 6, kind, 2, 1)
    parts = [words(2), record(called), words(-1, 7), record(trailer), words(-2, 1, 0, 2)]
    parts += [record(called), words(-3, 1, 1)]
    for at, column in enumerate(matrix.T):
        content = struct.pack('i', 1) + column.tobytes()
        last = at == columns - 1
        parts += [words(len(content) // 4), record(content), words(-4 - at, 1, 0 if last else 1)]
    return b''.join(parts) + words(0)


def output2(file: Path, **matrices: Any) -> Path:
    """Write the nodes of two grids, and matrices behind them, to one output2 file."""
    blocks = (
        output2_matrix(name, m, 4 if np.iscomplexobj(m) else 2) for name, m in matrices.items()
    )
    end = words(0)
    file.write_bytes(TWO_NODES.read_bytes().removesuffix(end) + b''.join(blocks) + end)
    return file


def test_an_output2_file_has_matrices_and_nodes(tmp_path: Path) -> None:
    both = pair(12)
    op4.write(str(tmp_path / 'both.op4'), both)
    other = read_matrices(tmp_path / 'both.op4', None, str(TWO_NODES))
    # a modal stiffness and the map of a superelement are no pair
    rest = {'KHH': np.eye(3), 'MAPS': np.ones((1, 5))}
    whole = output2(tmp_path / 'all.op2', KAA=both['kaa'], **rest, MAA=both['maa'])
    apart = output2(tmp_path / 'k.op2', KGG=both['kaa'])
    mass = output2(tmp_path / 'm.op2', MGG=both['maa'])
    for found in (read_matrices(whole, None, None), read_matrices(apart, str(mass), None)):
        assert abs(found.stiffness - other.stiffness).max() == 0.0
        assert abs(found.mass - other.mass).max() == 0.0
        assert (found.nodes == other.nodes).all()
        assert (found.dof_axes == other.dof_axes).all()


def test_what_an_output2_file_lacks_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    both = pair(12)
    bad = output2(tmp_path / 'bad.op2', KGG=both['kaa'])
    with pytest.raises(ModelError, match='must be the mass, named M…, got SUPERID, KGG'):
        read_matrices(bad, None, None)
    with pytest.raises(ModelError, match='must be the stiffness, named K…, got SUPERID'):
        read_matrices(TWO_NODES, None, None)
    output2(bad, KGG=both['kaa'], MGG=1j * both['maa'])
    with pytest.raises(ModelError, match='matrix MGG must be real'):
        read_matrices(bad, None, None)
    output2(bad, KGG=both['kaa'], MGG=both['maa'])
    monkeypatch.setattr(matrices, 'MOST_BYTES', 5000)
    with pytest.raises(ModelError, match=r'must have at most 4 GB'):
        read_matrices(bad, None, None)
    bad.write_bytes(bad.read_bytes()[:1800])
    monkeypatch.setattr(matrices, 'MOST_BYTES', 4 << 30)
    with pytest.raises(ModelError, match='the file must be'):
        read_matrices(bad, None, None)
    content = output2_matrix('KGG', np.eye(2)) + output2_matrix('MGG', np.eye(2)) + words(0)
    bad.write_bytes(content)
    with pytest.raises(ModelError, match='an output2 file with BGPDT, EQEXIN and USET'):
        read_matrices(bad, None, None)
    bad.write_bytes(content.replace(struct.pack('2i', 2, 2), struct.pack('2i', 10**6, 10**6)))
    with pytest.raises(ModelError, match=r'at most 23170 rows .* OUTPUT4'):
        read_matrices(bad, None, None)


@pytest.mark.long
def test_rows_of_ansys_are_the_beam_s() -> None:
    """A clamped bar of 5 x 1 x 1: bending (sheared by 2 %), torsion and stretch of bars."""
    rows, (stiffness, mass), constrained = ansys_matrices(Path(examples.fullfile))
    free = np.flatnonzero(stiffness.diagonal() > 0.0)
    assert len(free) == len(rows) - constrained
    dense = (matrix.toarray()[np.ix_(free, free)] for matrix in (stiffness, mass))
    found = np.sqrt(eigh(*dense, eigvals_only=True, subset_by_index=(0, 6))) / (2.0 * np.pi)
    material = reader.read_binary(examples.rstfile).materials[1]
    young, density = float(material['EX']), float(material['DENS'])
    shear = young / (2.0 * (1.0 + float(material['NUXY'])))
    bending = 1.8751041**2 / (2.0 * np.pi) * np.sqrt(young / 12.0 / density) / 25.0
    share = 6.0 * rectangle_torsion_constant(1.0, 1.0)  # of the polar moment, 1/6
    assert found[:2] == pytest.approx([0.98 * bending] * 2, rel=0.01)
    assert found[2] == pytest.approx(np.sqrt(shear * share / density) / 20.0, rel=0.015)
    stretch = np.sqrt(young / density) / 20.0
    assert np.abs(found / stretch - 1.0).min() < 0.015


@pytest.mark.long
def test_nodes_of_an_ansys_result_are_the_body_s(monkeypatch: pytest.MonkeyPatch) -> None:
    file = Path(examples.fullfile)
    keys, both, _ = ansys_matrices(file)
    monkeypatch.setattr(matrices, 'ansys_matrices', lambda file: (keys, both, 0))
    body = read_matrices(file, None, examples.rstfile)
    mesh = reader.read_binary(examples.rstfile).mesh
    assert body.nodes == pytest.approx(mesh.nodes[:, :3], abs=0.0)
    assert len(body.dof_nodes) == len(keys)
    node, axis = keys[7]
    row = np.flatnonzero(mesh.nnum == node)[0]
    assert (body.dof_nodes[7], body.dof_axes[7]) == (row, axis - 1)


@pytest.mark.parametrize(
    ('size', 'nodes', 'message'),
    [
        (13, TWO_NODES, r'must have 12 rows \(g-set\) or 12 \(a-set\) .* got 13'),
        (34, REDUCED / 'nas2cam_notall6_nx2021.op2', 'rows must be of nodes alone, got 10 of'),
        (12, NASTRAN / 'nastran_op2_data' / 'double_le.op2', 'an output2 file with BGPDT'),
        (12, None, r'or an \.op2 file'),
    ],
)
def test_a_bad_output2_file_is_told(
    size: int, nodes: Path | None, message: str, tmp_path: Path
) -> None:
    op4.write(str(tmp_path / 'both.op4'), pair(size))
    with pytest.raises(ModelError, match=message):
        read_matrices(tmp_path / 'both.op4', None, None if nodes is None else str(nodes))


@pytest.mark.long
def test_bad_ansys_files_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = Path(examples.fullfile)
    with pytest.raises(ModelError, match=r'nodes must be given, got none: --nodes FILE\.rst'):
        read_matrices(file, None, None)
    with pytest.raises(ModelError, match=r'must have no constraint, got .* constrained rows'):
        read_matrices(file, None, examples.rstfile)
    torn = tmp_path / 'torn.full'
    torn.write_bytes(file.read_bytes()[:3000])
    with pytest.raises(ModelError, match='stiffness and mass, got'):
        read_matrices(torn, None, examples.rstfile)
    keys, both, _ = ansys_matrices(file)
    monkeypatch.setattr(matrices, 'ansys_matrices', lambda file: (keys, both, 0))
    copy = tmp_path / 'wrong.rst'
    copy.write_bytes(b'nothing')
    with pytest.raises(ModelError, match='a result file with its mesh'):
        read_matrices(file, None, str(copy))


@pytest.mark.parametrize(
    ('module', 'extra'), [('pyyeti.nastran', 'nastran'), ('ansys.mapdl.reader', 'ansys')]
)
def test_a_missing_reader_names_its_extra(
    module: str, extra: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    file = Path(examples.fullfile)
    if extra == 'nastran':
        file = tmp_path / 'both.op4'
        op4.write(str(file), pair(12))
    with pytest.raises(ModelError, match=rf"pip install 'denoc_ros\[{extra}\]'"):
        read_matrices(file, None, examples.rstfile)
