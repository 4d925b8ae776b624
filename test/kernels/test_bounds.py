"""With DENOC_CHECK_BOUNDS=1 every offset of a kernel is compared with its array's length."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from strategies import random_state, seeded_robot

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.dynamics.robot_model import Workspace
from denoc_ros.kernels import CHECKED
from denoc_ros.kernels.jit import handle
from denoc_ros.kernels.jit.cache import cache_folder
from denoc_ros.kernels.layout import layout as at_

checked = pytest.mark.skipif(not CHECKED, reason='in the mode that checks offsets')
SHORT = ('-k', 'not loops and not mechanisms and not derivatives')
TIMEOUT = 550.0  # s, with kernels to compile on a loaded machine
HERE = Path(__file__).parent


def spoiled(column: int, value: int) -> tuple[Robot, Workspace]:
    """Return a robot, and a workspace in which the last body's offset is another."""
    robot = load_robot(seeded_robot(3, 6))
    robot.arrays.topology.setflags(write=True)
    last = int(robot.arrays.bodies)
    robot.arrays.topology[last, column] = value
    return robot, robot.new_workspace()


def inverse(robot: Robot) -> None:
    state = random_state(robot.coordinate_names, 1)
    robot.inverse_dynamics(state.q, state.qd, state.qdd)


@checked
@pytest.mark.parametrize(
    ('column', 'value'),
    [(at_.WORK, 10**6), (at_.WORK, 2**32 - 40), (at_.BEAM_WORK, 10**6), (at_.COORDINATE, 10**5)],
)
def test_a_planted_offset_is_found_out(column: int, value: int) -> None:
    robot, workspace = spoiled(column, value)
    robot._use(workspace)
    with pytest.raises(
        IndexError, match=r'^denoc_ros\.kernels[.\w]+: offset must lie within its array of'
    ):
        inverse(robot)
    inverse(load_robot(seeded_robot(3, 6)))


@checked
@pytest.mark.parametrize('element', ['TOPOLOGY_LENGTH', 'CONSTANTS_LENGTH', 'WORK_LENGTH'])
def test_an_array_that_is_too_short_is_found_out(element: str) -> None:
    robot = load_robot(seeded_robot(3, 6))
    robot._workspace._record[getattr(handle, element)] = 30
    with pytest.raises(IndexError, match='offset must lie within its array'):
        inverse(robot)


@checked
def test_an_output_that_is_too_short_is_found_out() -> None:
    """Kernels over rows trust who calls them to give arrays of the same rows."""
    from denoc_ros.kernels.dynamics.inverse import inverse_dynamics_rows

    robot = load_robot(seeded_robot(3, 6))
    inverse(robot)
    rows, short = np.zeros((3, robot.n)), np.zeros((2, robot.n))
    robot.inverse_dynamics(rows, rows, rows)  # compiles it
    with pytest.raises(IndexError, match='offset must lie within its array of float64'):
        inverse_dynamics_rows(robot.handle, (rows, rows, rows, short), 0, 3)


@pytest.mark.skipif(CHECKED, reason='this is that mode')
@pytest.mark.parametrize(
    'names',
    [
        ('test_bounds.py',),
        pytest.param(('test_bounds.py', 'test_canaries.py'), marks=pytest.mark.long),
    ],
)
def test_dynamics_stay_within_their_arrays(names: tuple[str, ...]) -> None:
    """The tests above and the canaries', in a process that checks every offset.

    Without the kernels of loops and derivatives, which take minutes to compile:
    `python -m campaigns bounds` has them.
    """
    files = [str(HERE / name) for name in names]
    done = subprocess.run(
        [sys.executable, '-m', 'pytest', '-q', '-p', 'no:cacheprovider', *files, *SHORT],
        env={**os.environ, 'DENOC_CHECK_BOUNDS': '1'},
        capture_output=True,
        text=True,
        timeout=TIMEOUT,
        cwd=HERE.parents[1],
    )
    assert done.returncode == 0, done.stdout[-3000:]
    assert ' passed, 2 skipped' in done.stdout


def test_each_mode_has_a_cache_of_its_own() -> None:
    prefix = 'checked-' if CHECKED else 'kernels-'
    folder = cache_folder()
    assert folder is not None
    assert folder.name.startswith(prefix)
