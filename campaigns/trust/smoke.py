"""The package as others get it: sdist, its wheel, an empty environment, each command.

`python -m campaigns smoke` prints each trial with its status and time, and fails if one does.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pages import LINK

from denoc_ros.cli.session.session_config import NODES

ROOT = Path(__file__).resolve().parents[2]
PATIENCE = 600.0  # s: compiles of all kernels on a slow machine
# what one process tries: every robot, every page of help, every module, every launch file
INSIDE = """
import io, pkgutil, sys
from contextlib import redirect_stdout
from importlib import import_module
from pathlib import Path
import denoc_ros
from denoc_ros.cli.session.session_config import share_directory
from denoc_ros.cli.main import main, verbs
from denoc_ros.parts import node_main
share, package = share_directory(), Path(denoc_ros.__file__).parent
assert not (package.parent / 'package.xml').exists(), package
assert package.joinpath('py.typed').is_file()
robots = sorted(share.glob('config/robots/*.urdf'))
for path in robots:
    denoc_ros.load_robot(path)
for verb in verbs():
    with redirect_stdout(io.StringIO()) as shown:
        assert main([verb, '--help']) == 0, verb
    assert shown.getvalue().startswith('usage: denoc ' + verb), verb
names = [node_main(name) for name in NODES]
for name in names:
    assert callable(import_module(name).main), name
launched = sorted(share.glob('launch/*.launch.py'))
for path in launched:
    compile(path.read_text('utf-8'), path, 'exec')
for name in denoc_ros.__all__:
    getattr(denoc_ros, name)
assert len(robots) > 30
assert len(launched) > 5
"""
COMMANDS = """
denoc --version
denoc check robots/canadarm.urdf
denoc check --json robots/canadarm.urdf
denoc simulate robots/canadarm.urdf scenarios/canadarm.yaml -o run.mcap
denoc report run.mcap
denoc replay run.mcap --set beam.link_1.y.ei=9e4
denoc view run.mcap --strip strip.png
denoc recover run.mcap -o recovered
denoc shape robots/five_bar_ffff.urdf five_bar.yaml -o plan.yaml
denoc dh dh/canadarm.yaml --kinds FFR -o arm.urdf
denoc export mjcf robots/canadarm.urdf -o arm.xml
denoc up canadarm.yaml --time simulated
"""


@dataclass(frozen=True)
class Trial:
    """Outcome of one trial; `fault` is empty if it went as it must."""

    name: str
    seconds: float
    fault: str = ''


def inside_script() -> str:
    """Return the script that tries what needs no process of its own."""
    return f'NODES = {tuple(NODES)!r}\n{INSIDE}'


def lost_links(share: Path) -> list[str]:
    """Return the links of the installed pages that lead nowhere."""
    pages = [*sorted(share.glob('*.md')), *sorted(share.glob('docs/**/*.md'))]
    assert len(pages) > 20, f'{share}: pages must be installed, got {len(pages)}'
    return [
        f'{page.relative_to(share)}: {target}'
        for page in pages
        for target in LINK.findall(page.read_text(encoding='utf-8'))
        if not (page.parent / target).exists()
    ]


def tried(name: str, command: Sequence[str], folder: Path, environment: dict[str, str]) -> Trial:
    """Run a command to its end; a status that is not 0 is a fault."""
    begun = time.monotonic()
    ended = subprocess.run(
        command,
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    fault = '' if ended.returncode == 0 else f'status {ended.returncode}: {ended.stderr[-400:]}'
    if 'Traceback' in ended.stderr:
        fault = ended.stderr[-400:]
    return Trial(name, time.monotonic() - begun, fault)


def tried_node(name: str, place: Path, folder: Path, environment: dict[str, str]) -> Trial:
    """Start a node, end it by SIGTERM once it has said that it is up."""
    begun = time.monotonic()
    arguments = [
        '--ros-args',
        '-p',
        f'urdf_path:={place}/share/denoc_ros/config/robots/canadarm.urdf',
    ]
    node = subprocess.Popen(
        [str(place / 'bin' / f'denoc-{name}'), *(arguments if name != 'recorder' else [])],
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert node.stdout is not None
    first = node.stdout.readline()
    time.sleep(10.0)
    alive = node.poll() is None
    node.send_signal(signal.SIGTERM)
    rest, _ = node.communicate(timeout=PATIENCE)
    words = first + rest
    good = alive and node.returncode == 0 and 'Traceback' not in words
    fault = '' if good else f'alive {alive}, status {node.returncode}: {words[-400:]}'
    return Trial(f'denoc-{name}', time.monotonic() - begun, fault)


def trials(place: Path, folder: Path) -> Iterator[Trial]:
    """Try all that an environment with the package has."""
    environment = {
        'PATH': f'{place}/bin:/usr/bin:/bin',
        'HOME': str(folder),
        'LANG': 'C.UTF-8',
        'ROS_DOMAIN_ID': os.environ.get('ROS_DOMAIN_ID', '77'),
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        'OPENBLAS_NUM_THREADS': '1',
    }
    python = str(place / 'bin' / 'python')
    yield tried('pip check', [python, '-m', 'pip', 'check'], folder, environment)
    yield tried('inside', [python, '-I', '-c', inside_script()], folder, environment)
    for line in COMMANDS.strip().splitlines():
        yield tried(line, line.split(), folder, environment)
    for name in NODES:
        if name != 'viewer':  # it needs the extra of that name
            yield tried_node(name, place, folder, environment)
    lost = lost_links(place / 'share' / 'denoc_ros')
    yield Trial('links of the pages', 0.0, ', '.join(lost))


def built_wheel(folder: Path) -> Path:
    """Build the sdist, and the wheel from it, of a copy of what git has."""
    source = folder / 'source'
    subprocess.run(['git', 'clone', '--quiet', f'file://{ROOT}', str(source)], check=True)
    command = [sys.executable, '-m', 'build', '--outdir', str(folder / 'dist'), str(source)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    shutil.rmtree(source)
    assert list((folder / 'dist').glob('*.tar.gz'))
    (wheel,) = (folder / 'dist').glob('*.whl')
    return wheel


def main() -> int:
    """Build, install and try; return 1 if anything failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--wheel', type=Path, help='this one; default: build it')
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        begun = time.monotonic()
        wheel = options.wheel or built_wheel(folder)
        print(f'{time.monotonic() - begun:6.1f} s  {wheel.name}', flush=True)
        place, work = folder / 'place', folder / 'work'
        work.mkdir()
        begun = time.monotonic()
        venv.create(place, with_pip=True)
        pip = [str(place / 'bin' / 'python'), '-m', 'pip', 'install', '--quiet']
        pins = ['--constraint', str(ROOT / 'constraints.txt')]
        subprocess.run([*pip, *pins, f'{wheel.resolve()}[ros]'], check=True)
        print(f'{time.monotonic() - begun:6.1f} s  pip install [ros]', flush=True)
        failed = 0
        for trial in trials(place, work):
            failed += bool(trial.fault)
            print(f'{trial.seconds:6.1f} s  {trial.name}  {trial.fault or "good"}', flush=True)
    print(f'{failed} failed')
    return int(failed > 0)


if __name__ == '__main__':
    sys.exit(main())
