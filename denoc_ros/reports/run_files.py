"""The files of a run: its bag and its session file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import BagError

EARTH = (0.0, 0.0, -9.81)  # m/s^2, where nothing is said
FORMATS = ('.mcap', '.db3', '.csv', '.tsv', '.txt', '.dat', '.mat', '.json')
BAG_FOLDER = 'bag'
SESSION_FILE = 'session.json'
SESSION_KINDS: dict[str, type] = {
    **dict.fromkeys(
        ('kind', 'name', 'robot', 'tip', 'command', 'scenario', 'failure', 'beams'), str
    ),
    **dict.fromkeys(('model', 'plant', 'versions', 'time'), dict),
    **dict.fromkeys(('gravity', 'phases'), list),
    'geometric_stiffness': bool,
}
SIMULATED = 'simulate'  # kind of a session
STEPPED = 'simulated'  # mode of a session's time


def recording_name(path: Path) -> str:
    """Name of a recording: the file's without the suffix of its format.

    A dot in the name of a folder is no suffix: `run_0.55s` is not `run_0`.
    """
    name = path.resolve().name
    return next((name[: -len(end)] for end in FORMATS if name.lower().endswith(end)), name)


def find_bag(run_path: Path) -> Path:
    """Return the bag of a run's directory, or the bag itself."""
    if not run_path.exists():
        raise BagError(f'{run_path}: run must be a directory or a bag, got nothing there')
    inside = run_path / BAG_FOLDER
    return inside if inside.is_dir() else run_path


def plant_of(robot: Robot, session: Mapping[str, Any]) -> Robot:
    """Return the robot whose states a run recorded: the file's as the session changed it.

    Raises
    ------
    ConfigError, ModelError
        The session's paths are not of this robot.
    """
    overrides = {**session.get('plant', {}), **session.get('model', {})}
    return robot.with_overrides(overrides) if overrides else robot


def read_session(run_path: Path) -> dict[str, Any]:
    """Session document of a run's directory, or of a bag of `denoc simulate`; else empty."""
    from denoc_ros.bags.reader import SESSION_ATTACHMENT, read_attachment

    file = run_path / SESSION_FILE
    try:
        if file.is_file():
            text = file.read_bytes()
        else:
            text = read_attachment(run_path, SESSION_ATTACHMENT)
    except BagError:
        return {}
    try:
        session = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise BagError(f'{run_path}: {SESSION_FILE} must be JSON, got: {error}') from error
    kinds = [(name, SESSION_KINDS.get(name)) for name in session if isinstance(session, dict)]
    wrong = [name for name, kind in kinds if kind and not isinstance(session[name], kind)]
    if wrong or not isinstance(session, dict):
        raise BagError(
            f'{run_path}: {SESSION_FILE} must be what denoc up or simulate wrote, got other '
            f'values: {", ".join(wrong) or repr(session)[:60]}'
        )
    return session
