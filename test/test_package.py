"""The package as others get it: what a wheel holds, what an installation finds, what is pinned."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import xml.etree.ElementTree as ElementTree
import zipfile
from email import message_from_bytes
from email.message import Message
from importlib import metadata
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import NormalizedName, canonicalize_name
from trust.smoke import inside_script, lost_links, tried

from denoc_ros.cli.session.session_config import NODES
from denoc_ros.parts import node_main
from denoc_ros.versions import source_commit

# What is written, packed or listed is the whole package.
pytestmark = pytest.mark.parts('all')

BUILD_TIMEOUT = 300.0  # s for what takes ten on a machine that does nothing else
EXTRAS = ('ros', 'viewer', 'test')
# those of the package index that fit; any other would be refused there
CLASSIFIERS = {
    'Development Status :: 4 - Beta',
    'Environment :: Console',
    'Intended Audience :: Developers',
    'Intended Audience :: Science/Research',
    'Operating System :: POSIX :: Linux',
    'Programming Language :: Python :: 3',
    *(f'Programming Language :: Python :: 3.{minor}' for minor in range(10, 14)),
    'Topic :: Scientific/Engineering',
    'Typing :: Typed',
}


def pip(*arguments: str) -> None:
    """Run pip without any index."""
    command = [sys.executable, '-m', 'pip', *arguments, '--quiet', '--no-index', '--no-deps']
    subprocess.run(command, check=True, timeout=BUILD_TIMEOUT, stdin=subprocess.DEVNULL)


def git(folder: Path, *arguments: str) -> str:
    """Run git in a checkout, as nobody in particular."""
    person = ('-c', 'user.name=test', '-c', 'user.email=test@localhost')
    command = ['git', '-C', str(folder), *person, *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


@pytest.fixture(scope='module')
def checkout(source_copy: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the sources as a checkout of one commit."""
    folder = tmp_path_factory.mktemp('checkout') / 'denoc_ros'
    shutil.copytree(source_copy, folder)
    git(folder, 'init', '--quiet')
    git(folder, 'add', '--all')
    git(folder, 'commit', '--quiet', '--message', 'all')
    return folder


@pytest.fixture(scope='module')
def sdist(checkout: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('sdist')
    script = 'import sys; from setuptools import build_meta; build_meta.build_sdist(sys.argv[1])'
    subprocess.run(
        [sys.executable, '-c', script, str(folder)],
        cwd=checkout,
        check=True,
        timeout=BUILD_TIMEOUT,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
    )
    (path,) = folder.glob('*.tar.gz')
    return path


@pytest.fixture(scope='module')
def wheel(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the wheel that the sdist builds, with nothing beside it."""
    folder = tmp_path_factory.mktemp('wheel')
    pip('wheel', str(sdist), '--no-build-isolation', '--wheel-dir', str(folder))
    (path,) = folder.glob('*.whl')
    return path


def wheel_metadata(wheel: Path) -> Message:
    """Return the metadata of a wheel."""
    archive = zipfile.ZipFile(wheel)
    (name,) = (name for name in archive.namelist() if name.endswith('.dist-info/METADATA'))
    return message_from_bytes(archive.read(name))


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
    tracked = git(repository, 'ls-files', 'config', 'launch', 'docs').splitlines()
    assert len(tracked) > 100
    assert not {f'share/denoc_ros/{path}' for path in tracked} - shared
    assert {f'lib/denoc_ros/{node}' for node in NODES} <= shared
    assert 'share/ament_index/resource_index/packages/denoc_ros' in shared


def test_wheel_holds_the_type_marker_and_all_licences(repository: Path, wheel: Path) -> None:
    held = set(zipfile.ZipFile(wheel).namelist())
    assert 'denoc_ros/py.typed' in held
    (info,) = {name.partition('/')[0] for name in held if '.dist-info/' in name}
    licences = {'LICENSE', *git(repository, 'ls-files', 'config/robots/*.LICENSE').split()}
    assert len(licences) > 1
    assert {f'{info}/licenses/{name}' for name in licences} <= held
    assert set(wheel_metadata(wheel).get_all('License-File') or []) == licences


def test_metadata_says_what_the_package_is(repository: Path, wheel: Path) -> None:
    told = wheel_metadata(wheel)
    classifiers = told.get_all('Classifier') or []
    oldest = Requirement(f'python{told["Requires-Python"]}').specifier
    for name in classifiers:
        assert name in CLASSIFIERS, name
    versions = [name.rpartition(' ')[2] for name in classifiers if re.search(r':: 3\.\d+$', name)]
    assert versions
    assert all(oldest.contains(version) for version in versions)
    assert told['Description-Content-Type'] == 'text/markdown'
    description = told.get_payload(decode=True)
    assert isinstance(description, bytes)
    readme = (repository / 'README.md').read_text(encoding='utf-8').strip()
    assert readme in description.decode('utf-8')


def test_commit_of_the_checkout_is_in_sdist_and_wheel(
    checkout: Path, prefix: Path, tmp_path: Path
) -> None:
    commit = git(checkout, 'rev-parse', '--short=12', 'HEAD')
    modules = Path(sysconfig.get_path('purelib', vars={'base': str(prefix)}))
    assert source_commit(modules / 'denoc_ros') == commit
    assert source_commit(checkout / 'denoc_ros') == commit
    shown = subprocess.run(
        [prefix / 'bin' / 'denoc', '--version'],
        env={**os.environ, 'PYTHONPATH': str(modules)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
        timeout=BUILD_TIMEOUT,
    )
    first, second = shown.stdout.splitlines()
    assert re.fullmatch(rf'denoc_ros [\d.]+ \(commit {commit}\)', first)
    assert second == f'documentation: {prefix}/share/denoc_ros/README.md'


def test_commit_is_that_of_the_package_s_own_checkout_only(checkout: Path, tmp_path: Path) -> None:
    shutil.copytree(checkout / 'denoc_ros', tmp_path / 'copy')
    assert source_commit(tmp_path / 'copy') == ''
    git(tmp_path, 'init', '--quiet')
    git(tmp_path, 'commit', '--quiet', '--allow-empty', '--message', 'of somebody else')
    assert source_commit(tmp_path / 'copy') == ''
    git(tmp_path, 'add', 'copy')
    git(tmp_path, 'commit', '--quiet', '--message', 'copy')
    assert source_commit(tmp_path / 'copy') == git(tmp_path, 'rev-parse', '--short=12', 'HEAD')
    (tmp_path / 'copy' / '__init__.py').write_text('')
    assert source_commit(tmp_path / 'copy').endswith('-dirty')


def test_links_of_the_installed_pages_lead_to_installed_files(prefix: Path) -> None:
    assert lost_links(prefix / 'share' / 'denoc_ros') == []


def test_installed_package_has_every_robot_command_node_and_launch_file(
    prefix: Path, tmp_path: Path
) -> None:
    modules = sysconfig.get_path('purelib', vars={'base': str(prefix)})
    environment = {**os.environ, 'PYTHONPATH': modules}
    trial = tried('inside', [sys.executable, '-c', inside_script()], tmp_path, environment)
    assert trial.fault == ''


def test_pages_that_messages_name_are_installed(repository: Path, prefix: Path) -> None:
    named = {
        page
        for path in (repository / 'denoc_ros').rglob('*.py')
        for page in re.findall(r'docs/\w+\.md', path.read_text(encoding='utf-8'))
    }
    assert len(named) > 5
    assert [page for page in named if not (prefix / 'share' / 'denoc_ros' / page).is_file()] == []


def test_changelog_has_the_version_or_announces_it(repository: Path) -> None:
    text = (repository / 'CHANGELOG.md').read_text(encoding='utf-8')
    headings = re.findall(r'^## (.*)$', text, re.MULTILINE)
    version = ElementTree.parse(repository / 'package.xml').getroot().findtext('version')
    for heading in headings:
        assert re.fullmatch(r'\[Unreleased\]|\[\d+\.\d+\.\d+\] - \d{4}-\d\d-\d\d', heading)
    newest = text.split('\n## ')[1]
    assert newest.startswith(f'[{version}]') or f'will be {version}' in newest
    kinds = set(re.findall(r'^### (.*)$', text, re.MULTILINE))
    assert kinds <= {'Added', 'Changed', 'Deprecated', 'Removed', 'Fixed', 'Security'}


def test_every_node_is_a_console_script(prefix: Path) -> None:
    scripts = {path.name: path.read_text() for path in (prefix / 'bin').iterdir()}
    assert scripts.keys() == {'denoc', *(f'denoc-{node}' for node in NODES)}
    for node in NODES:
        assert f'from {node_main(node)} import main\n' in scripts[f'denoc-{node}']


def test_installed_package_finds_the_configurations_that_came_with_it(
    prefix: Path, tmp_path: Path
) -> None:
    modules = sysconfig.get_path('purelib', vars={'base': str(prefix)})
    script = (
        'import denoc_ros.cli.session.session_config as c; '
        'print(c.load_config("canadarm.yaml").robot)'
    )
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


# rosdep's keys on Ubuntu 24.04 (rosdistro's rosdep/python.yaml); '' where it has none, or one that
# is of no use there: apt's numba may be too old, and pip refuses to write into that system
ROSDEP = {
    'clarabel': '',
    'imageio-ffmpeg': '',
    'jinja2': 'python3-jinja2',
    'lxml': 'python3-lxml',
    'matplotlib': 'python3-matplotlib',
    'mcap': '',
    'numba': '',
    'numpy': 'python3-numpy',
    'pyyaml': 'python3-yaml',
    'rosbags': '',
    'scipy': 'python3-scipy',
    'tqdm': 'python3-tqdm',
    'trimesh': '',
    'viser': '',
    'yourdfpy': '',
    'zstandard': '',
}


def test_package_xml_has_what_rosdep_has_and_the_page_supplies_the_rest(
    repository: Path, wheel: Path
) -> None:
    """Every requirement of the wheel is a key of rosdep or in the command of docs/install.md."""
    needed = {}
    for line in wheel_metadata(wheel).get_all('Requires-Dist') or []:
        requirement = Requirement(line)
        marker = requirement.marker
        if marker is None or marker.evaluate({'extra': 'viewer'}):
            needed[requirement.name] = requirement.specifier
    assert needed.keys() == ROSDEP.keys()
    root = ElementTree.parse(repository / 'package.xml').getroot()
    declared = {element.text for element in root.iter('exec_depend')}
    assert {key for key in ROSDEP.values() if key} == {
        key for key in declared if key and key.startswith('python3-')
    }
    page = (repository / 'docs' / 'install.md').read_text(encoding='utf-8')
    (command,) = re.findall(r"^pip install ('numba.*)$", page, re.MULTILINE)
    supplied = {r.name: r.specifier for r in map(Requirement, re.findall(r"'(.*?)'", command))}
    assert {name: supplied.get(name) for name, key in ROSDEP.items() if not key} == {
        name: needed[name] for name, key in ROSDEP.items() if not key
    }


def test_package_xml_names_the_licence_files(repository: Path) -> None:
    root = ElementTree.parse(repository / 'package.xml').getroot()
    files = {element.get('file') for element in root.iter('license')}
    assert files == {'LICENSE', *git(repository, 'ls-files', 'config/robots/*.LICENSE').split()}


def test_conda_recipe_needs_what_wheel_and_package_xml_need(repository: Path, wheel: Path) -> None:
    text = (repository / 'conda' / 'recipe.yaml').read_text(encoding='utf-8')
    recipe = yaml.safe_load(text)
    root = ElementTree.parse(repository / 'package.xml').getroot()
    assert recipe['context']['version'] == root.findtext('version')
    run = {
        Requirement(line).name: Requirement(line).specifier
        for line in recipe['requirements']['run']
    }
    lines = wheel_metadata(wheel).get_all('Requires-Dist') or []
    needed = [r for r in map(Requirement, lines) if r.marker is None]
    conda = {'matplotlib': 'matplotlib-base'}
    assert {name: s for name, s in run.items() if not name.startswith(('ros-', 'python'))} == {
        conda.get(r.name, r.name): r.specifier for r in needed
    }
    ros = {e.text for kind in ('depend', 'exec_depend') for e in root.iter(kind) if e.text}
    assert {name for name in run if name.startswith('ros-')} == {
        f'ros-jazzy-{name.replace("_", "-")}' for name in ros if not name.startswith('python3-')
    }
    assert set(recipe['about']['license_file']) == {
        element.get('file') for element in root.iter('license')
    }
