"""`denoc calibrate` of an IMU or accelerometer: mounting and biases from a bag."""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path

import numpy as np

from denoc_ros.bags.series import INERTIAL_NUMBERS, read_joint_states, read_numbers
from denoc_ros.cli.exit_statuses import DOUBTFUL, NOT_IDENTIFIABLE
from denoc_ros.cli.written_description import write_description
from denoc_ros.dynamics.measured_side import measured_robot
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError, IdentificationError
from denoc_ros.estimation.calibration import Mounting, calibrate_mounting
from denoc_ros.estimation.joint_motion import smooth
from denoc_ros.model.overrides import remounted_description
from denoc_ros.types import Array

MOST = 1000  # readings, evenly out of all: the amplitudes of each are in equilibrium
CUTOFF = 5.0  # Hz, of the joints' motion: vibration is not what is looked for


def run_mounting(args: argparse.Namespace, file: Path, robot: Robot) -> int:
    """Fit, show and write; return the exit status."""
    robot = measured_robot(robot)
    try:
        found = calibrate_mounting(robot, args.sensor, *_record(args, robot))
    except IdentificationError as error:
        print(f'denoc calibrate: {error}', file=sys.stderr)
        return NOT_IDENTIFIABLE
    written = write_description(
        args, file, lambda: remounted_description(file, args.sensor, found.rotation)
    )
    _show(args, found, written)
    return DOUBTFUL if found.doubts else 0


def _record(args: argparse.Namespace, robot: Robot) -> tuple[Array, Array, Array, Array]:
    """Return motion (k, n) three times and readings of the bag."""
    (sensor,) = (s for s in robot.tree.inertial_sensors if s.name == args.sensor)
    if not sensor.topic:
        raise ConfigError(str(args.robot), [f'sensor {sensor.name!r} must have a topic, got none'])
    stamp_ns, readings = read_numbers(args.readings, sensor.topic, INERTIAL_NUMBERS)
    joints = read_joint_states(args.readings, names=robot.joint_names)
    inside = np.flatnonzero(
        (stamp_ns >= joints.stamp_ns.min(initial=np.iinfo(np.int64).max))
        & (stamp_ns <= joints.stamp_ns.max(initial=0))
    )
    if len(inside) < 10:
        raise IdentificationError(
            f'{args.sensor}: at least 10 readings must come with joint states, got {len(inside)}'
        )
    chosen = inside[np.linspace(0, len(inside) - 1, min(MOST, len(inside))).astype(int)]
    begin = joints.stamp_ns[0]
    rising = np.flatnonzero(np.diff(joints.stamp_ns, prepend=begin - 1) > 0)
    t = 1e-9 * (joints.stamp_ns[rising] - begin)
    rates = joints.velocity[rising]
    motion = smooth(
        t, joints.position[rising], rates if np.isfinite(rates).all() else None, cutoff=CUTOFF
    )
    at = 1e-9 * (stamp_ns[chosen] - begin)
    q, qd, qdd = (
        np.column_stack([np.interp(at, t, column) for column in part.T])
        for part in (motion.q, motion.qd, motion.qdd)
    )
    whole = np.zeros((3, len(at), robot.n))
    whole[0] = robot.static_deflection(q)
    whole[1][:, robot.joint_indices], whole[2][:, robot.joint_indices] = qd, qdd
    return whole[0], whole[1], whole[2], readings[chosen]


def _show(args: argparse.Namespace, found: Mounting, written: str) -> None:
    if args.json:
        row = {
            key: value.tolist() if hasattr(value, 'tolist') else value
            for key, value in vars(found).items()
        }
        print(json.dumps({'sensor': args.sensor, **row, 'written': written}, indent=2))
        return
    degrees = math.degrees(found.angle), math.degrees(found.angle_error)
    print(f'{args.sensor}: turned by {degrees[0]:.3f} +- {degrees[1]:.2g} deg on its link')
    for name, bias, error, residual, unit in (
        ('gyro', found.gyro_bias, found.gyro_bias_error, found.gyro_residual, 'rad/s'),
        ('accel', found.accel_bias, found.accel_bias_error, found.accel_residual, 'm/s^2'),
    ):
        if residual > 0.0:
            listed = '  '.join(
                f'{x:.5g} +- {e:.2g}' for x, e in zip(bias.tolist(), error.tolist(), strict=True)
            )
            print(f'{name}_bias   {listed} {unit}, residual {residual:.3g}')
    for doubt in found.doubts:
        print(f'doubtful: {doubt}')
    if written:
        print(f'written     {written}')
