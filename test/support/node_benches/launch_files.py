"""What launch files declare and start, by the stand-in for ROS's packages."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Mapping
from pathlib import Path

from launch_stand_in import (
    Context,
    DeclareLaunchArgument,
    ExecuteProcess,
    LaunchDescription,
    installed,
)


def load(file: Path) -> LaunchDescription:
    """Return the description of a launch file; to be called while `installed`."""
    name = re.sub(r'\W', '_', file.stem)
    specification = importlib.util.spec_from_file_location(name, file)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    description = module.generate_launch_description()
    assert isinstance(description, LaunchDescription)
    return description


def arguments(file: Path) -> dict[str, DeclareLaunchArgument]:
    """Return the arguments that a launch file declares."""
    with installed():
        entities = load(file).entities
    return {each.name: each for each in entities if isinstance(each, DeclareLaunchArgument)}


def started(file: Path, given: Mapping[str, str], context: Context) -> list[ExecuteProcess]:
    """Return what a launch file starts with arguments, as `ros2 launch` would."""
    context.launch_configurations.update(given)
    found: list[ExecuteProcess] = []
    with installed():
        waiting = load(file).entities
        while waiting:
            entity = waiting.pop(0)
            if isinstance(entity, ExecuteProcess):
                found.append(entity)
            waiting[:0] = entity.execute(context) or []
    return found
