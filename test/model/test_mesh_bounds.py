"""Meshes from strangers: bounded memory, no pipes, no files that a file names."""

from __future__ import annotations

import base64
import json
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from peak_memory import peak_memory

import denoc_ros as dn
from denoc_ros.child_arrays import child_arrays
from denoc_ros.errors import ModelError
from denoc_ros.model.beams.section_profiles import read_outline
from denoc_ros.model.reading.mesh_files import SURFACE_FORMATS, read_surface, read_surfaces
from denoc_ros.reduction.suggest.suggestion import suggest_flexibility
from denoc_ros.viewer.outline import outlines

MEMORY_RISE = 200_000  # KiB by which the peak of all processes may rise


@pytest.mark.parametrize('suffix', SURFACE_FORMATS)
def test_each_format_gives_the_mesh_that_was_written(tmp_path: Path, suffix: str) -> None:
    box = trimesh.creation.box(extents=(1.0, 2.0, 3.0))
    file = tmp_path / f'box{suffix}'
    box.export(file)
    found = read_surface(file)
    assert found.volume == pytest.approx(box.volume)
    np.testing.assert_allclose(np.sort(found.extents), np.sort(box.extents))


def test_a_bad_file_leaves_the_others_readable(tmp_path: Path) -> None:
    files = [tmp_path / f'{k}.stl' for k in range(4)]
    for file in files:
        trimesh.creation.box().export(file)
    files[1].write_text('no mesh')
    files[2].unlink()
    found = read_surfaces(files)
    assert [isinstance(found[file], ModelError) for file in files] == [False, True, True, False]


def test_a_file_that_ends_its_reader_leaves_the_others_readable(tmp_path: Path) -> None:
    script = tmp_path / 'script.py'
    script.write_text(
        'import os, signal\n'
        'def read(file):\n'
        '    if file.endswith("bad"):\n'
        '        os.kill(os.getpid(), signal.SIGKILL)\n'
        '    return {"file": len(file)}\n'
    )
    files = [tmp_path / name for name in ('good', 'bad', 'good', 'bad')]
    found = child_arrays(str(script), files)
    assert [one if isinstance(one, str) else int(one['file']) for one in found] == [
        len(str(files[0])),
        'status -9: no word',
        len(str(files[0])),
        'status -9: no word',
    ]


@pytest.mark.parametrize(
    'body',
    [
        'numpy.ones(1 << 32)',
        '[bytes(1 << 20) for _ in range(1 << 14)]',
        'open(os.path.dirname(file) + "/pipe").read()',
        '__import__("socket").create_connection(("127.0.0.1", 9))',
        'os.system("true")',
        'numpy.array([object()])',
    ],
)
def test_a_reader_has_bounds_and_returns_plain_arrays(tmp_path: Path, body: str) -> None:
    os.mkfifo(tmp_path / 'pipe')
    script = tmp_path / 'script.py'
    script.write_text(f'import os, numpy\ndef read(file):\n    return {{"a": {body}}}\n')
    (found,) = child_arrays(str(script), [tmp_path / 'any'], memory=1 << 30)
    assert isinstance(found, str)
    assert found


def bomb(file: Path) -> None:
    """Write a 3MF archive of which the model is far larger than the file."""
    part = '<vertex x="0" y="0" z="0"/>' * 4_000_000
    model = (
        '<model unit="millimeter" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">'
        f'<resources><object id="1" type="model"><mesh><vertices>{part}</vertices><triangles>'
        '<triangle v1="0" v2="1" v3="2"/></triangles></mesh></object></resources>'
        '<build><item objectid="1"/></build></model>'
    )
    with zipfile.ZipFile(file, 'w', zipfile.ZIP_DEFLATED) as archive:
        archive.writestr('3D/3dmodel.model', model)


def gltf(file: Path, uri: str) -> None:
    """Write a glTF file of one triangle, whose numbers are in another file."""
    document = {
        'asset': {'version': '2.0'},
        'buffers': [{'uri': uri, 'byteLength': 36}],
        'bufferViews': [{'buffer': 0, 'byteLength': 36}],
        'accessors': [{'bufferView': 0, 'componentType': 5126, 'count': 3, 'type': 'VEC3'}],
        'meshes': [{'primitives': [{'attributes': {'POSITION': 0}}]}],
        'nodes': [{'mesh': 0}],
        'scenes': [{'nodes': [0]}],
        'scene': 0,
    }
    file.write_text(json.dumps(document))


def robot_of(name: str) -> str:
    """Return a URDF of an arm whose links show a mesh."""
    shape = f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'
    inertial = (
        '<inertial><origin xyz="0.5 0 0"/><mass value="2"/><inertia ixx="0.01" iyy="0.2" '
        'izz="0.2" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    links = ''.join(f'<link name="l{k}">{shape}{inertial}</link>' for k in range(2))
    return (
        f'<robot name="arm"><link name="base"/>{links}'
        '<joint name="j0" type="continuous"><parent link="base"/><child link="l0"/></joint>'
        '<joint name="j1" type="continuous"><parent link="l0"/><child link="l1"/>'
        '<origin xyz="1 0 0"/></joint></robot>'
    )


@pytest.mark.parametrize('kind', ['bomb.3mf', 'pipe.gltf', 'pipe.obj', 'pipe.stl', 'scene.glb'])
def test_no_mesh_of_a_robot_fills_the_memory_or_waits(
    tmp_path: Path, kind: str, caplog: pytest.LogCaptureFixture
) -> None:
    """A 3MF file of 3.9 MB took 2.1 GB, and a glTF file that names a pipe never ended."""
    os.mkfifo(tmp_path / 'pipe')
    file = tmp_path / kind
    if kind == 'bomb.3mf':
        bomb(file)
    elif kind == 'pipe.gltf':
        gltf(file, 'pipe')
    elif kind == 'pipe.obj':
        file.write_text('mtllib pipe\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\n')
    elif kind == 'pipe.stl':
        os.mkfifo(file)
    else:
        header = base64.b64decode('Z2xURgIAAAD/////')
        file.write_bytes(header + b'\xff\xff\xff\x7fJSON' + b' ' * 100)
    text = robot_of(kind)
    path = tmp_path / 'arm.urdf'
    path.write_text(text)
    read_surfaces([])
    before = peak_memory()
    assert len(outlines(dn.load_robot(text), tmp_path)) > 0
    assert suggest_flexibility(path).text
    assert peak_memory() - before < MEMORY_RISE
    assert kind in caplog.text or 'cannot be drawn' in caplog.text


def test_an_outline_has_the_bounds_of_a_mesh(tmp_path: Path) -> None:
    path = trimesh.load_path(np.array([[0, 0], [2, 0], [2, 1], [0, 1], [0, 0]], dtype=float))
    path.export(str(tmp_path / 'box.dxf'))
    ((*corners,),) = read_outline(tmp_path / 'box.dxf', 0.001)
    assert {tuple(np.round(corner, 9)) for corner in corners} == {
        (0.0, 0.0),
        (0.002, 0.0),
        (0.002, 0.001),
        (0.0, 0.001),
    }
    (tmp_path / 'bad.dxf').write_bytes(b'AutoCAD Binary DXF\r\n\x1a\x00' + b'\xff' * 100)
    with pytest.raises(ModelError, match='file must be an outline of y and z'):
        read_outline(tmp_path / 'bad.dxf', 1.0)
