"""Processes import nothing from the folder in which they are started, on every Python."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh

from denoc_ros.cli.session.processes import Processes
from denoc_ros.model.reading.mesh_files import read_surface
from denoc_ros.python_start import code_words, file_words, module_words
from denoc_ros.runtime.worker.worker import Planner

TIMEOUT = 120.0  # s on a busy machine
TRAPS = ('html', 'numpy', 'json', 'runpy', 'argparse', 'denoc_ros', 'yaml')
PROBE = (
    'import json, sys\n'
    'print(json.dumps({"path": sys.path, "words": sys.argv, "name": __name__}))\n'
)


@pytest.fixture
def trap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a marker that any module in the working folder writes when it is imported.

    The interpreter is one that knows no PYTHONSAFEPATH, as Python 3.10.
    """
    folder = tmp_path / 'downloads'
    folder.mkdir()
    marker = tmp_path / 'executed'
    for name in TRAPS:
        (folder / f'{name}.py').write_text(f'open({str(marker)!r}, "w").write({name!r})\n')
    interpreter = tmp_path / 'python'
    interpreter.write_text(f'#!/bin/sh\nunset PYTHONSAFEPATH\nexec {sys.executable} "$@"\n')
    interpreter.chmod(0o755)
    monkeypatch.setattr(sys, 'executable', str(interpreter))
    monkeypatch.delenv('PYTHONSAFEPATH', raising=False)
    monkeypatch.chdir(folder)
    return marker


@pytest.mark.parametrize('kind', ['module', 'file', 'code'])
def test_a_process_has_neither_the_working_folder_nor_its_own_on_the_path(
    trap: Path, tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / 'installed'
    place.mkdir()
    probe = place / 'the_probe.py'
    probe.write_text(PROBE)
    if kind == 'module':
        monkeypatch.setenv('PYTHONPATH', str(place))
        words, first = module_words('the_probe', 'a b', '-m'), str(probe)
    elif kind == 'file':
        words, first = file_words(str(probe), 'a b', '-m'), str(probe)
    else:
        words, first = code_words(PROBE, 'a b', '-m'), '-c'
    told = subprocess.run(
        [sys.executable, *words], capture_output=True, check=True, timeout=TIMEOUT
    )
    seen = json.loads(told.stdout)
    assert seen['words'] == [first, 'a b', '-m']
    assert seen['name'] == '__main__'
    assert not {'', os.getcwd()} & set(seen['path'])
    assert (str(place) in seen['path']) == (kind == 'module')
    assert not trap.exists()


@pytest.mark.ros
def test_a_node_and_the_player_import_what_is_installed(trap: Path, tmp_path: Path) -> None:
    processes = Processes(tmp_path, {})
    words = {
        'denoc_ros.cli.player': ['--help'],
        'denoc_ros.nodes.plant': ['--ros-args', '-p', 'no parameter'],
    }
    for name, given in words.items():
        processes.start(name, module_words(name, *given), ends=True)
    until = time.monotonic() + TIMEOUT
    while any(map(processes.running, words)):
        assert time.monotonic() < until
        time.sleep(0.1)
    # Both came to the words after their imports.
    assert 'usage:' in (tmp_path / 'denoc_ros.cli.player.log').read_text()
    said = (tmp_path / 'denoc_ros.nodes.plant.log').read_text()
    assert said.startswith('plant: starting')
    assert 'no parameter' in said
    assert not trap.exists()


def test_the_planner_imports_what_is_installed(trap: Path) -> None:
    planner = Planner()
    try:
        until = time.monotonic() + TIMEOUT
        while planner.pid is None:
            planner.start(time.perf_counter())
            assert time.monotonic() < until
            time.sleep(0.05)
        while b'worker_process' not in Path(f'/proc/{planner.pid}/cmdline').read_bytes():
            assert time.monotonic() < until
            time.sleep(0.05)
        time.sleep(2.0)  # It has imported a module of the folder by then, if any.
    finally:
        planner.close()
    assert not trap.exists()


def test_the_reader_of_meshes_imports_what_is_installed(trap: Path, tmp_path: Path) -> None:
    box = trimesh.creation.box()
    box.export(tmp_path / 'box.stl')
    np.testing.assert_allclose(read_surface(tmp_path / 'box.stl').extents, box.extents)
    assert not trap.exists()


def test_no_other_file_of_the_package_starts_python(repository: Path) -> None:
    package = repository / 'denoc_ros'
    starting = [
        str(file.relative_to(package))
        for file in package.rglob('*.py')
        if re.search(r"""['"]-[mc]['"],""", file.read_text(encoding='utf-8'))
    ]
    assert starting == ['python_start.py']
