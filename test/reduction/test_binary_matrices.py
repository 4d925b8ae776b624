"""Matrices in Nastran's and Ansys' own files.

The `.op2` files are of pyyeti's wheel (BSD-3-Clause), `file.full` and `file.rst` of
ansys-mapdl-reader's (MIT): a bar of 40 bricks, clamped in the first and free in the second.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import pyyeti
from ansys.mapdl import reader
from ansys.mapdl.reader import examples
from pyyeti.nastran import op4
from scipy.linalg import eigh

from denoc_ros.errors import ModelError
from denoc_ros.model.cross_sections import rectangle_torsion_constant
from denoc_ros.reduction import matrices
from denoc_ros.reduction.matrices import ansys_matrices, read_matrices
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


def test_rows_of_ansys_are_the_beam_s() -> None:
    """A clamped bar of 5 x 1 x 1: bending (sheared by 2 %), torsion and stretch of bars."""
    keys, (stiffness, mass), constrained = ansys_matrices(Path(examples.fullfile))
    free = np.flatnonzero(stiffness.diagonal() > 0.0)
    assert len(free) == len(keys) - constrained
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
