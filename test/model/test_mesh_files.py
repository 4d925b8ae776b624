"""Where meshes are looked for."""

from __future__ import annotations

from pathlib import Path

import pytest

from denoc_ros.model.reading.mesh_files import mesh_file


def test_mesh_files_come_from_the_folder_or_a_package_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = tmp_path / 'share' / 'arm' / 'meshes' / 'link.stl'
    mesh.parent.mkdir(parents=True)
    mesh.touch()
    folder = tmp_path / 'share' / 'arm' / 'urdf'
    folder.mkdir()
    assert mesh_file('../meshes/link.stl', folder) == folder / '../meshes/link.stl'
    assert mesh_file('package://arm/meshes/link.stl', folder) == mesh
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    assert mesh_file('package://arm/meshes/link.stl', None) == mesh
    assert mesh_file(f'file://{mesh}', None) == mesh
    assert mesh_file('package://moved/meshes/link.stl', folder) == mesh
    assert mesh_file('http://127.0.0.1/link.stl', folder) is None
    assert mesh_file('missing.stl', folder) is None
