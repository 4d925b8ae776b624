"""A ROS workspace: colcon builds the package, its executables run from install/."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from child_processes import child

from denoc_ros.cli.session.session_config import NODES

pytestmark = pytest.mark.ros

BUILD_TIMEOUT = 300.0  # s for what takes ten on a machine that does nothing else
START_TIMEOUT = 300.0  # s, with kernels to compile; seconds when they come from the cache
END_TIMEOUT = 60.0
STREAMS = {'stdin': subprocess.DEVNULL, 'stderr': subprocess.PIPE}
PARAMETERS = """\
feedforward:
  ros__parameters:
    urdf_path: {robot}
    model: rigid
    update_rate: 200.0
    joint_state_timeout: 1
"""


@pytest.fixture(scope='module')
def workspace(source_copy: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a workspace that `colcon build` has built."""
    root = tmp_path_factory.mktemp('workspace')
    (root / 'src').mkdir()
    (root / 'src' / 'denoc_ros').symlink_to(source_copy)
    built = subprocess.run(
        [sys.executable, '-m', 'colcon', 'build'],
        cwd=root,
        env={**os.environ, 'PATH': search_path()},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=BUILD_TIMEOUT,
    )
    assert built.returncode == 0, built.stdout + built.stderr
    return root


def search_path() -> str:
    """Return a PATH on which python3 is this one."""
    return os.pathsep.join([str(Path(sys.executable).parent), os.environ.get('PATH', os.defpath)])


@pytest.fixture(scope='module')
def overlay(workspace: Path) -> dict[str, str]:
    """Return the environment after `. install/setup.sh`."""
    listed = subprocess.run(
        ['/bin/sh', '-c', '. install/setup.sh && env -0'],
        cwd=workspace,
        env={**os.environ, 'PATH': search_path()},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60.0,
        check=True,
    )
    return dict(entry.split('=', 1) for entry in listed.stdout.split('\0') if entry)


def executable(workspace: Path, name: str) -> Path:
    """Return what `ros2 run denoc_ros NAME` starts."""
    return workspace / 'install' / 'denoc_ros' / 'lib' / 'denoc_ros' / name


def test_workspace_is_an_ament_prefix(workspace: Path, overlay: dict[str, str]) -> None:
    prefix = workspace / 'install' / 'denoc_ros'
    assert str(prefix) in overlay['AMENT_PREFIX_PATH'].split(os.pathsep)
    assert (
        prefix / 'share' / 'ament_index' / 'resource_index' / 'packages' / 'denoc_ros'
    ).exists()
    assert (prefix / 'share' / 'denoc_ros' / 'package.xml').is_file()
    # what `ros2 run denoc_ros` starts
    assert all(os.access(executable(workspace, each), os.X_OK) for each in (*NODES, 'denoc'))


def test_workspace_comes_before_other_installations(
    workspace: Path, overlay: dict[str, str]
) -> None:
    script = (
        'import denoc_ros.cli.session.session_config as c; '
        'print(c.__file__); print(c.share_directory())'
    )
    shown = subprocess.run(
        ['python3', '-c', script],
        env=overlay,
        cwd=workspace,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60.0,
        check=True,
    )
    prefix = workspace / 'install' / 'denoc_ros'
    module, share = shown.stdout.splitlines()
    assert Path(module).is_relative_to(prefix)
    assert Path(share) == prefix / 'share' / 'denoc_ros'


def test_node_runs_from_the_workspace(
    graph: Any, workspace: Path, overlay: dict[str, str], tmp_path: Path
) -> None:
    robots = workspace / 'install' / 'denoc_ros' / 'share' / 'denoc_ros' / 'config' / 'robots'
    parameters = tmp_path / 'feedforward.yaml'
    parameters.write_text(PARAMETERS.format(robot=robots / 'two_link_ff.urdf'))
    command = [str(executable(workspace, 'feedforward')), '--ros-args']
    command += ['--params-file', str(parameters)]
    overlay = overlay | {'ROS_DOMAIN_ID': os.environ['ROS_DOMAIN_ID']}
    with child(command, env=overlay, **STREAMS) as process:
        graph.until(
            lambda: 'feedforward: loop' in graph.diagnostics or process.poll() is not None,
            timeout=START_TIMEOUT,
        )
        assert process.poll() is None, process.communicate()[1]
        assert graph.value('feedforward: loop', 'nominal_rate_hz') == '200'
        process.send_signal(signal.SIGINT)
        assert process.wait(END_TIMEOUT) == 0


def test_bad_parameter_ends_the_node_with_its_message(
    graph: Any, workspace: Path, overlay: dict[str, str]
) -> None:
    command = [str(executable(workspace, 'recorder')), '--ros-args', '-p', 'flush_period:=-1.0']
    with child(command, env=overlay, **STREAMS) as process:
        message = process.communicate(timeout=60.0)[1]
    assert process.returncode == 1
    assert "parameter 'flush_period' must be > 0, <= 60 s, got -1.0" in message
    assert 'Traceback' not in message
