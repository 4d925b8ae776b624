"""Identification of one recording's free decay: its modes, and the damping of the model."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import Any

from denoc_ros.cli.identify_inputs import (
    asked_of,
    attached_robot,
    channel_of,
    joint_values,
    load_named_robot,
)
from denoc_ros.errors import DenocError
from denoc_ros.identification.analysis import DecayAnalysis, analyse_decay
from denoc_ros.identification.apply import USABLE, configuration
from denoc_ros.identification.channel import Reading, joint_positions, read_record
from denoc_ros.identification.damping import Assigned, assign_damping
from denoc_ros.identification.modes import strongest
from denoc_ros.identification.result import modal_result
from denoc_ros.identification.windows import standing_spans
from denoc_ros.reports.versions import versions

Document = dict[str, Any]


def identify(args: argparse.Namespace, path: Path) -> tuple[Document, DecayAnalysis]:
    """Return the result for one recording, ready for a file, and the analysis it is from."""
    channel, (band, count) = channel_of(args), asked_of(args)
    reading = read_record(path, channel)
    given = channel.begin > 0.0 or math.isfinite(channel.end)
    held = args.joints == 'held'
    analysis = analyse_decay(reading.record, given, standing_spans(reading) if held else ())
    coefficients, model = _of_model(args, reading, analysis)
    modes = analysis.modes
    asked = strongest(modes.frequency, modes.energy, band, count)
    document = modal_result(reading, analysis, coefficients, versions(), model, asked)
    return document, analysis


def _of_model(
    args: argparse.Namespace, reading: Reading, analysis: DecayAnalysis
) -> tuple[dict[int, Assigned], Document]:
    """Return the amplitudes of the model that the good modes determine, and which model it is.

    Without a robot, where the joints stood is all.
    """
    modes = analysis.modes
    measured = joint_positions(reading, modes.start, modes.stop) | joint_values(args.at)
    robot = (
        load_named_robot(args.robot, args.gravity)
        if args.robot
        else attached_robot(reading.path, args.gravity)
    )
    if robot is None:
        return {}, {'joints': measured} if measured else {}
    joints = {name: measured[name] for name in robot.joint_names if name in measured}
    joints |= joint_values(args.at)
    model: Document = {
        'robot': robot.tree.name,
        'file': args.robot or 'attached to the bag',
        'joints': joints,
        'held': args.joints == 'held',
        'gravity': list(args.gravity),
    }
    usable = [k for k, verdict in enumerate(modes.verdict) if verdict in USABLE]
    if not usable:
        return {}, model
    try:
        assigned = assign_damping(
            robot,
            configuration(robot, joints),
            modes.frequency[usable],
            modes.damping_ratio[usable],
            args.joints == 'held',
            modes.amplitude[usable],
        )
    except DenocError as error:
        if args.robot:
            print(f'denoc identify: coefficients left out: {error}', file=sys.stderr)
        return {}, {**model, 'left_out': str(error)}
    return {usable[one.mode]: one for one in assigned}, model
