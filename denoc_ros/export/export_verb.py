"""`denoc export mjcf|sdf ROBOT -o ARM`: the robot as another simulator's model."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from denoc_ros.cli.arguments import (
    add_gravity,
    add_json,
    add_option,
    add_output,
    add_overrides,
    given_file,
    overrides_of,
)
from denoc_ros.cli.postures import add_postures, posture, read_postures
from denoc_ros.cli.verb_result import VerbResult
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError
from denoc_ros.export.mjcf import mjcf
from denoc_ros.export.mujoco_chain import ChainComparison, compare
from denoc_ros.export.sdf import sdf
from denoc_ros.model.beams.segments import whole_beams
from denoc_ros.model.overrides import with_overrides
from denoc_ros.output_files import require_new, write_new
from denoc_ros.text_table import text_table

FINER = 8  # segments per beam of the model that ours is compared with
DESCRIPTION = (
    "Write a robot as MuJoCo's or Gazebo's model: each beam becomes a chain of rigid rods on "
    'sprung hinges, which has nothing of the shape functions. What the format cannot hold is '
    'refused by name.'
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_option(
        parser, 'format', 'mjcf: an XML file of MuJoCo; sdf: of Gazebo', choices=('mjcf', 'sdf')
    )
    add_option(parser, 'robot', 'the URDF file')
    add_output(parser, '', 'the file to write, a new file', required=True)
    add_option(parser, '--segments N', 'hinges per beam and deformation; default: 16', 16)
    add_gravity(parser)
    add_overrides(parser)
    add_option(
        parser,
        '--verify',
        "compare natural frequencies and sag with MuJoCo's, joints held; needs mujoco",
    )
    add_postures(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> VerbResult:
    """Write the other simulator's model; errors are raised."""
    require_new(args.output)
    if args.verify and args.format == 'sdf':
        rule = '--verify must come with mjcf: no Gazebo is run, and SDF has the same chain'
        raise ConfigError('denoc export', [f'{rule}, got sdf'])
    file = given_file(args.robot, 'robot')
    tree = with_overrides(file, overrides_of(args.set, args.payload))
    robot = Robot(tree, gravity=tuple(args.gravity))
    export = mjcf if args.format == 'mjcf' else sdf
    made = export(tree, robot.gravity, args.segments, file.parent)
    summary: dict[str, Any] = {'output': str(args.output), 'notes': list(made.notes)}
    if args.verify:
        summary['verified'] = _verify(robot, made.text, args.at)
    write_new(args.output, made.text)
    lines = [
        f'{args.output}: {len(robot.joint_names)} joints, {args.segments} hinges per beam',
        *(line for found in summary.get('verified', ()) for line in _lines(found)),
    ]
    notes = () if args.json else [f'denoc export: note: {note}' for note in made.notes]
    return VerbResult(summary, lines, notes=notes)


def _verify(robot: Robot, text: str, at: Any) -> list[dict[str, Any]]:
    """Return frequencies and sags at each posture, ready for JSON."""
    if len(robot.base_indices):
        robot = Robot(robot.tree, gravity=(0.0, 0.0, 0.0))
    finer = Robot(with_overrides(robot.tree, _finer(robot)), gravity=tuple(robot.gravity))
    postures = read_postures(robot, at) or [posture(robot, [0.0] * len(robot.joint_names))]
    found = []
    for each in postures:
        joints = each.q[robot.joint_indices].tolist()
        fine = compare(finer, text, posture(finer, joints).q)
        found.append(_rows(each.name, compare(robot, text, each.q), fine))
    return found


def _finer(robot: Robot) -> dict[str, Any]:
    divided: dict[str, Any] = {}
    for whole in whole_beams(robot.tree):
        if whole.segments == 1:
            divided[f'beam.{whole.link}.segments'] = FINER
    return divided


def _rows(name: str, own: ChainComparison, fine: ChainComparison) -> dict[str, Any]:
    frequencies = [
        {
            'model_hz': float(ours),
            'segments_hz': float(converged),
            'mujoco_hz': float(theirs),
            'model_percent': 100.0 * (float(ours) / float(theirs) - 1.0),
            'segments_percent': 100.0 * (float(converged) / float(theirs) - 1.0),
        }
        for ours, converged, theirs in zip(own.ours, fine.ours, own.mujoco, strict=False)
    ]
    sags = [
        {
            'link': sag.link,
            'model_m': [float(value) for value in sag.ours],
            'mujoco_m': [float(value) for value in sag.mujoco],
            'model_percent': 100.0 * sag.difference,
            'segments_percent': 100.0 * finer.difference,
        }
        for sag, finer in zip(own.sags, fine.sags, strict=True)
    ]
    return {'at': name, 'natural_frequencies': frequencies, 'sag': sags}


def _lines(found: dict[str, Any]) -> Iterator[str]:
    at = found['at']
    said = f'our model, the same with {FINER} segments per beam, and MuJoCo'
    if found['natural_frequencies']:
        table = text_table(found['natural_frequencies'])
        yield f'\nnatural frequencies, joints held at ({at}): {said}\n{table}'
        yield f'\nsag of the tips there\n{text_table(found["sag"])}'
    else:
        yield f'\nno beam bends: nothing vibrates with the joints held at ({at})'
