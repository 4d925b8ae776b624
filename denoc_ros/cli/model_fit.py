"""The model that fits recordings, as the options of a command ask for it."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from denoc_ros.cli.identify_inputs import load_named_robot
from denoc_ros.cli.overrides import overrides_of
from denoc_ros.cli.recording_options import recording_settings
from denoc_ros.dynamics.robot import Robot
from denoc_ros.identification.model.fit import IdentifiedModel, identify_model
from denoc_ros.identification.model.sources import read_source


def fitted_model(args: argparse.Namespace, paths: Sequence[Path]) -> IdentifiedModel:
    """Return the model that fits recordings best."""
    robot, settings = started_robot(args), recording_settings(args)
    read = [read_source(path, robot, settings) for path in paths]
    return identify_model(robot, read, args.free, cutoff=args.cutoff, held_out=args.held_out)


def started_robot(args: argparse.Namespace) -> Robot:
    """Return the robot where the search starts."""
    robot = load_named_robot(args.robot, args.gravity)
    overrides = overrides_of(args.set, args.payload)
    return robot.with_overrides(overrides) if overrides else robot
