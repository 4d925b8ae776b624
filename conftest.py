"""Fixtures of all tests."""

from __future__ import annotations

import os
import re
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings
from needed_parts import missing_parts, needed_parts
from ros_domains import claimed_domain
from simulated_bags import SimulatedBag, make_simulated_bag

pytest_plugins = ['comparison_fixtures', 'recorded_run_fixtures']

# a loaded machine, or kernels that check every offset, take their time
settings.register_profile('unhurried', deadline=None)
settings.load_profile('unhurried')

ROOT = Path(__file__).resolve().parent

# files that take longest, so that none of them is begun last (`--no-loadscope-reorder`)
LONGEST = (
    'test/feedback/test_feedback_by_gyroscopes.py',
    'test/feedback/test_state_feedback.py',
    'test/test_site.py',
    'test/test_docs.py',
    'test/planning/nodes/test_shaper.py',
    'test/nodes/predictor/test_input_faults.py',
    'test/nodes/session/test_up_simulated.py',
    'test/nodes/session/test_up_failures.py',
    'test/nodes/test_node_processes.py',
    'test/nodes/session/test_lockstep.py',
    'test/nodes/session/test_up.py',
    'test/nodes/session/test_up_auto.py',
    'test/planning/nodes/test_shaper_up.py',
    'test/nodes/session/test_node_ends.py',
    'test/nodes/session/test_two_robots.py',
    'test/feedback/test_gain_worker.py',
    'test/planning/test_worker_process.py',
    'test/export/nodes/test_mujoco_plant.py',
    'test/nodes/recorder/test_recorder_process.py',
    'campaigns/bench/loops/test_request_lateness.py',
    'campaigns/bench/loops/test_viewer_lateness.py',
    'test/planning/rest/test_rest_in_minimum_time.py',
    'test/planning/rest/test_rest_to_rest.py',
    'test/cli/test_streams.py',
    'test/identification/model/test_far_starts.py',
    'test/identification/model/test_broken_recordings.py',
    'test/identification/model/test_blind_truth.py',
    'test/identification/model/test_measured_channels.py',
    'test/identification/model/test_excitation.py',
    'test/identification/model/test_identified_models.py',
    'test/identification/model/test_followed_vibration.py',
    'test/planning/timing/test_minimum_time.py',
    'test/feedback/test_contact.py',
    'test/planning/tip/test_floating_tips.py',
    'test/estimation/test_fusion.py',
    'campaigns/book/test_bench.py',
    'test/test_package.py',
    'test/viewer/test_page_in_browser.py',
    'test/viewer/test_page.py',
)

SOURCES = (
    'CHANGELOG.md',
    'CONTRIBUTING.md',
    'SECURITY.md',
    'CODE_OF_CONDUCT.md',
    'CITATION.cff',
    'LICENSE',
    'MANIFEST.in',
    'README.md',
    'conda',
    'config',
    'constraints.txt',
    'denoc_ros',
    'docs',
    'launch',
    'package.xml',
    'pyproject.toml',
    'resource',
    'rosdoc2.yaml',
    'scripts',
    'setup.cfg',
    'setup.py',
)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out files that need a part of the package that was removed.

    Files that have no test of those asked for by `-m` are left out too: their imports take
    seconds. A file's own words say which markers it has.
    """
    if (
        collection_path.name.startswith('test_')
        and not collection_path.is_dir()
        and needed_parts(collection_path) & missing_parts()
    ):
        return True
    asked = str(config.getoption('markexpr')).split(' and ')
    known = all(re.fullmatch(r'(not )?(ros|alone|long)', each) for each in asked)
    if not known or not collection_path.name.startswith('test_') or collection_path.is_dir():
        return None
    words = collection_path.read_text('utf-8')
    for each in asked:
        name = each.removeprefix('not ')
        if name == each and f'mark.{name}' not in words:
            return True
        if name != each and re.search(rf'^pytestmark = .*mark\.{name}\b', words, re.M):
            return True
    return None


def pytest_itemcollected(item: pytest.Item) -> None:
    """Mark the cases of a test that are long, where others are its short form."""
    cases = item.get_closest_marker('long_cases')
    if cases is not None and isinstance(item, pytest.Function) and item.callspec.id in cases.args:
        item.add_marker(pytest.mark.long)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that take longest; leave out tests of parts that were removed."""
    gone = missing_parts()
    items[:] = [item for item in items if not gone.intersection(parts_of(item))]
    missing = [name for name in LONGEST if not (ROOT / name).is_file()]
    if missing and not gone:
        raise pytest.UsageError(f'LONGEST must name files, got {missing}')
    first = {ROOT / name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: first.get(item.path, len(first)))


def parts_of(item: pytest.Item) -> set[str]:
    """Return the parts of the package that a test names by its marker `parts`."""
    return {name for marker in item.iter_markers('parts') for name in marker.args}


@pytest.fixture(scope='session', autouse=True)
def ros_domain() -> Iterator[int]:
    """Claim a domain for this session, keep discovery on this machine; yield its id."""
    with claimed_domain() as domain:
        os.environ['ROS_DOMAIN_ID'] = str(domain)
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
        yield domain


@pytest.fixture(scope='session', autouse=True)
def signals_are_heard() -> None:
    """Take back what `nohup make test &` ignores: processes of the tests would inherit it."""
    if signal.getsignal(signal.SIGHUP) == signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope='session')
def repository() -> Path:
    """Root of the checkout."""
    return ROOT


@pytest.fixture(scope='session')
def simulated_bag(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> SimulatedBag:
    """Two flexible links, simulated once for all tests that read the run back."""
    return make_simulated_bag(repository, tmp_path_factory.mktemp('simulated'))


@pytest.fixture(scope='session')
def source_copy(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy of what the package is built from: building leaves nothing in the checkout."""
    target = tmp_path_factory.mktemp('src') / 'denoc_ros'
    target.mkdir()
    for name in SOURCES:
        source = repository / name
        if source.is_dir():
            ignored = shutil.ignore_patterns('__pycache__')
            shutil.copytree(source, target / name, ignore=ignored)
        elif source.is_file():
            shutil.copy2(source, target / name)
    return target
