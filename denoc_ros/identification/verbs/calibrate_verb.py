"""`denoc calibrate`: a sensor's gain and offset from readings at known references."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from denoc_ros.bags.series import elapsed, read_readings
from denoc_ros.cli.arguments import add_gravity, add_json, add_option, add_output
from denoc_ros.cli.session.session_config import find_file
from denoc_ros.cli.verb_result import VerbResult
from denoc_ros.cli.verbs import DOUBTFUL, NOT_IDENTIFIABLE
from denoc_ros.dynamics.driven.measured_side import measured_robot
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import ConfigError, IdentificationError
from denoc_ros.identification.calibration import (
    Calibration,
    calibrate,
    calibrate_mounting,
    calibration_paths,
    find_plateaus,
    match_levels,
    read_motion,
    sensor_values,
)
from denoc_ros.identification.tables.tables import read_sheet
from denoc_ros.model.overrides import edited_description, remounted_description
from denoc_ros.model.sensors import message_place
from denoc_ros.model.tree import INERTIAL_UNITS
from denoc_ros.output_files import write_new, write_text

KINDS = ('value', 'deflection', 'load')
DESCRIPTION = (
    'Fit value = gain raw + offset to a table, or to the plateaus of a bag; of an IMU or '
    'accelerometer the mounting and the biases to a bag with joint states. Exit status 2: the '
    'result is doubtful; 3: the readings do not determine it.'
)


def write_description(args: argparse.Namespace, file: Path, text: Callable[[], str]) -> str:
    """Write a changed description to the chosen file; return its path, '' without one.

    Raises
    ------
    ConfigError
        Both places are chosen, or the file cannot be written.
    BagError
        The new file exists already.
    """
    target = file if args.write else args.output
    if target is None:
        return ''
    if args.write and args.output is not None:
        raise ConfigError('--write', ['only one of --write and --output must be given, got both'])
    if args.write:
        write_text(file, text())
    else:
        write_new(target, text())
    return str(target)


def run_mounting(args: argparse.Namespace, file: Path, robot: Robot) -> VerbResult:
    """Fit the mounting and write it; exit status 2 with doubts."""
    robot = measured_robot(robot)
    try:
        found = calibrate_mounting(
            robot, args.sensor, *read_motion(args.readings, robot, args.sensor, args.robot)
        )
    except IdentificationError as error:
        return _not_identifiable(error)
    written = write_description(
        args, file, lambda: remounted_description(file, args.sensor, found.rotation)
    )
    row = {'sensor': args.sensor, **vars(found), 'written': written}
    return VerbResult(row, _mounting_lines(row), DOUBTFUL if found.doubts else 0)


def _mounting_lines(row: Mapping[str, Any]) -> Iterator[str]:
    degrees = math.degrees(row['angle']), math.degrees(row['angle_error'])
    yield f'{row["sensor"]}: turned by {degrees[0]:.3f} +- {degrees[1]:.2g} deg on its link'
    for name, unit in INERTIAL_UNITS.items():
        if row[f'{name}_residual'] > 0.0:
            pairs = zip(row[f'{name}_bias'], row[f'{name}_bias_error'], strict=True)
            listed = '  '.join(f'{x:.5g} +- {e:.2g}' for x, e in pairs)
            yield f'{name}_bias   {listed} {unit}, residual {row[f"{name}_residual"]:.3g}'
    for doubt in row['doubts']:
        yield f'doubtful: {doubt}'
    if row['written']:
        yield f'written     {row["written"]}'


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_option(parser, 'readings', 'a CSV table (columns reference, raw), or a bag')
    add_option(parser, '--robot', 'the URDF file with the sensor', required=True)
    add_option(parser, '--sensor', 'name of the sensor', required=True)
    add_option(
        parser,
        '--reference',
        "kind of the references: the sensor's own values (default), or, for a link held "
        'at the root and loaded at the tip, the deflection of the tip [m] or the load [N]',
        'value',
        choices=KINDS,
    )
    add_option(
        parser,
        '--levels X',
        'references of the plateaus of a bag, in order',
        type=float,
        nargs='+',
    )
    add_gravity(parser)
    add_option(parser, '--hold S', 'shortest plateau [s], default 1', 1.0)
    add_output(parser, '', 'write the calibrated URDF to a new file')
    add_option(parser, '--write', 'write the calibration into the robot file itself')
    add_json(parser)


def run(args: argparse.Namespace) -> VerbResult:
    """Fit the calibration and write it; exit status 2 with doubts, 3 without a result."""
    file = find_file(Path(args.robot), Path()) or Path(args.robot)
    robot = load_robot(file, gravity=tuple(args.gravity))
    if args.sensor in {sensor.name for sensor in robot.tree.inertial_sensors}:
        return run_mounting(args, file, robot)
    # an unknown sensor is better known of before a long bag is read
    sensor_values(robot, args.sensor, [], args.reference)
    try:
        raw, reference, deviation = _readings(args, robot)
        wanted = sensor_values(robot, args.sensor, reference, args.reference)
        found = calibrate(raw, wanted, deviation)
    except IdentificationError as error:
        return _not_identifiable(error)
    written = _write(args, file, found)
    row = {'sensor': args.sensor, **vars(found), 'written': written}
    doubts = () if args.json else [f'denoc calibrate: doubtful: {one}' for one in found.doubts]
    return VerbResult(row, _lines(row), DOUBTFUL if found.doubts else 0, doubts)


def _not_identifiable(error: IdentificationError) -> VerbResult:
    """Return the result of readings that do not determine a calibration."""
    return VerbResult(None, (), NOT_IDENTIFIABLE, [f'denoc calibrate: {error}'])


def _readings(args: argparse.Namespace, robot: Robot) -> tuple[Any, Any, float]:
    """Return readings, references and the deviation of one reading."""
    path = Path(args.readings)
    if path.is_file() and path.suffix not in ('.mcap', '.db3'):
        if args.levels:
            raise ConfigError('--levels', ['levels must come with a bag, got a table'])
        return (*read_table(path), math.nan)
    if not args.levels:
        raise ConfigError('--levels', ['levels must be given for the plateaus of a bag, got none'])
    (sensor,) = (s for s in robot.tree.sensors if s.name == args.sensor)
    if not sensor.topic:
        raise ConfigError(str(args.robot), [f'sensor {sensor.name!r} must have a topic, got none'])
    stamp_ns, raw = read_readings(path, sensor.topic, [message_place(sensor, robot.tree)])
    plateaus = find_plateaus(elapsed(stamp_ns), raw[:, 0], args.hold)
    return plateaus.means, match_levels(plateaus, args.levels), plateaus.deviation


def read_table(path: Path) -> tuple[list[float], list[float]]:
    """Return readings and references of a CSV table.

    Parameters
    ----------
    path : Path
        A text or a spreadsheet as `bags.tables.read_table` reads it: two columns,
        reference and raw, in the order of measuring; or more with a header that names these two.

    Raises
    ------
    ConfigError
        With every line that is not two numbers.
    BagError
        The file cannot be read.
    """
    sheet = read_sheet(path)
    raw: list[float] = []
    reference: list[float] = []
    findings: list[str] = []
    columns = (0, 1)
    if {'reference', 'raw'} <= set(sheet.names):
        columns = (sheet.names.index('reference'), sheet.names.index('raw'))
    for number, cells in sheet.rows:
        pair = [sheet.number(cells[column]) if column < len(cells) else None for column in columns]
        found = [value for value in pair if value is not None and math.isfinite(value)]
        if len(found) < 2:
            findings.append(
                f'line {number} must have a reference and a reading, got {", ".join(cells)!r}'
            )
            continue
        reference.append(found[0])
        raw.append(found[1])
    ConfigError.raise_any(str(path), findings)
    return raw, reference


def _write(args: argparse.Namespace, file: Path, found: Calibration) -> str:
    paths = calibration_paths(args.sensor, found)
    return write_description(args, file, lambda: edited_description(file, paths))


def _lines(row: Mapping[str, Any]) -> Iterator[str]:
    yield f'{row["sensor"]}: value = gain raw + offset, {row["points"]} points'
    for name in ('gain', 'offset'):
        yield f'{name:11} {row[name]:.6g} +- {row[f"{name}_error"]:.2g}'
    yield f'residual    {row["residual"]:.3g}'
    for name in ('hysteresis', 'curvature'):
        share = row[name]
        yield f'{name:11} {"not known" if math.isnan(share) else f"{share:.2%} of the range"}'
    if math.isfinite(row['noise']):
        yield f'noise       {row["noise"]:.3g}'
    if row['written']:
        yield f'written     {row["written"]}'
