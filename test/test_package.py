"""The package as others get it: what a wheel holds, what an installation finds, what is pinned."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import sysconfig
import xml.etree.ElementTree as ElementTree
import zipfile
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import NormalizedName, canonicalize_name

from denoc_ros.cli.config import NODES

BUILD_TIMEOUT = 300.0  # s for what takes ten on a machine that does nothing else
EXTRAS = ('ros', 'viewer', 'test')


def pip(*arguments: str) -> None:
    """Run pip without any index."""
    command = [sys.executable, '-m', 'pip', *arguments, '--quiet', '--no-index', '--no-deps']
    subprocess.run(command, check=True, timeout=BUILD_TIMEOUT, stdin=subprocess.DEVNULL)


@pytest.fixture(scope='module')
def wheel(source_copy: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('wheel')
    pip('wheel', str(source_copy), '--no-build-isolation', '--wheel-dir', str(folder))
    (path,) = folder.glob('*.whl')
    return path


@pytest.fixture(scope='module')
def prefix(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a prefix with the wheel installed, its modules on no default path."""
    folder = tmp_path_factory.mktemp('prefix')
    pip('install', str(wheel), '--prefix', str(folder), '--ignore-installed')
    return folder


def test_version_stands_in_package_xml_only(repository: Path, wheel: Path) -> None:
    version = ElementTree.parse(repository / 'package.xml').getroot().findtext('version')
    assert wheel.name.startswith(f'denoc_ros-{version}-')


def test_wheel_holds_every_module_and_data_file(repository: Path, wheel: Path) -> None:
    held = set(zipfile.ZipFile(wheel).namelist())
    package = repository / 'denoc_ros'
    modules = {
        f'denoc_ros/{path.relative_to(package)}'
        for pattern in ('*.py', '*.j2', '*.html', '*.css', '*.js', 'py.typed')
        for path in package.rglob(pattern)
    }
    assert not modules - held
    shared = {name.partition('.data/data/')[2] for name in held}
    configured = {
        f'share/denoc_ros/{path.relative_to(repository)}'
        for path in (repository / 'config').rglob('*')
        if path.is_file()
    }
    assert not configured - shared
    assert {f'lib/denoc_ros/{node}' for node in NODES} <= shared
    assert 'share/ament_index/resource_index/packages/denoc_ros' in shared


def test_every_node_is_a_console_script(prefix: Path) -> None:
    scripts = {path.name for path in (prefix / 'bin').iterdir()}
    assert scripts == {'denoc', *(f'denoc-{node}' for node in NODES)}


def test_installed_package_finds_the_configurations_that_came_with_it(
    prefix: Path, tmp_path: Path
) -> None:
    modules = sysconfig.get_path('purelib', vars={'base': str(prefix)})
    script = 'import denoc_ros.cli.config as c; print(c.load_config("canadarm.yaml").robot)'
    shown = subprocess.run(
        [sys.executable, '-c', script],
        env={**os.environ, 'PYTHONPATH': modules},
        cwd=tmp_path,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=BUILD_TIMEOUT,
    )
    assert shown.returncode == 0, shown.stderr
    assert Path(shown.stdout.strip()).is_relative_to(prefix / 'share' / 'denoc_ros')


def read_pins(path: Path) -> dict[NormalizedName, str]:
    """Return package -> version of the pins that hold for this Python."""
    pins: dict[NormalizedName, str] = {}
    for line in path.read_text().splitlines():
        if line and not line.startswith('#'):
            requirement = Requirement(line)
            assert requirement.url is None, line
            if requirement.marker is None or requirement.marker.evaluate():
                pins[canonicalize_name(requirement.name)] = str(requirement.specifier)
    return pins


def required_packages(root: str) -> set[NormalizedName]:
    """Return all that a package and its extras need here, by what is installed."""
    found: set[NormalizedName] = set()
    waiting: list[tuple[str, tuple[str, ...]]] = [(root, EXTRAS)]
    while waiting:
        name, extras = waiting.pop()
        for line in metadata.requires(name) or []:
            requirement = Requirement(line)
            marker = requirement.marker
            wanted = marker is None or any(marker.evaluate({'extra': e}) for e in ('', *extras))
            key = canonicalize_name(requirement.name)
            if wanted and (key not in found or requirement.extras):
                found.add(key)
                waiting.append((requirement.name, tuple(requirement.extras)))
    return found


def test_constraints_pin_all_that_is_installed(repository: Path) -> None:
    pins = read_pins(repository / 'constraints.txt')
    versions = {name: f'=={metadata.version(name)}' for name in required_packages('denoc_ros')}
    assert len(versions) > 100
    assert {name: pins.get(name) for name in versions} == versions


def test_declared_ros_dependencies_are_the_imported_ones(repository: Path) -> None:
    root = ElementTree.parse(repository / 'package.xml').getroot()
    declared = {element.text for element in root.iter('depend')}
    imported = {
        name
        for path in (repository / 'denoc_ros').rglob('*.py')
        for name in re.findall(
            r'^\s*(?:from|import) (rclpy|\w+_(?:msgs|srvs|interfaces))', path.read_text(), re.M
        )
    }
    assert declared == imported
