"""`denoc calibrate`: a sensor's gain and offset from readings at known references."""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import Any

from denoc_ros.bags.series import elapsed, read_readings
from denoc_ros.bags.tables import read_sheet
from denoc_ros.cli.arguments import add_gravity
from denoc_ros.cli.calibrate_mounting import run_mounting
from denoc_ros.cli.config import find_file
from denoc_ros.cli.exit_statuses import DOUBTFUL, NOT_IDENTIFIABLE
from denoc_ros.cli.verbs import VERBS
from denoc_ros.cli.written_description import write_description
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import ConfigError, IdentificationError
from denoc_ros.estimation.calibration import (
    Calibration,
    calibrate,
    calibration_paths,
    find_plateaus,
    match_levels,
    sensor_values,
)
from denoc_ros.model.overrides import edited_description
from denoc_ros.model.sensors import wrench_field

KINDS = ('value', 'deflection', 'load')


def add_parser(subparsers: Any) -> None:
    """Declare the verb's arguments."""
    parser = subparsers.add_parser(
        'calibrate',
        help=VERBS['calibrate'],
        description=(
            'Fit value = gain raw + offset to a table, or to the plateaus of a bag; of an IMU or '
            'accelerometer the mounting and the biases to a bag with joint states. Exit status 2: '
            'the result is doubtful; 3: the readings do not determine it.'
        ),
    )
    parser.add_argument('readings', help='a CSV table (columns reference, raw), or a bag')
    parser.add_argument('--robot', required=True, help='the URDF file with the sensor')
    parser.add_argument('--sensor', required=True, help='name of the sensor')
    parser.add_argument(
        '--reference',
        choices=KINDS,
        default='value',
        help=(
            "kind of the references: the sensor's own values (default), or, for a link held at"
            ' the root and loaded at the tip, the deflection of the tip [m] or the load [N]'
        ),
    )
    parser.add_argument(
        '--levels',
        type=float,
        nargs='+',
        metavar='X',
        help='references of the plateaus of a bag, in order',
    )
    add_gravity(parser)
    parser.add_argument(
        '--hold', type=float, default=1.0, metavar='S', help='shortest plateau [s], default 1'
    )
    parser.add_argument(
        '-o', '--output', type=Path, help='write the calibrated URDF to a new file'
    )
    parser.add_argument(
        '--write', action='store_true', help='write the calibration into the robot file itself'
    )
    parser.add_argument('--json', action='store_true', help='print machine-readable JSON')


def run(args: argparse.Namespace) -> int:
    """Run the verb and return the exit status; errors are raised."""
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
        print(f'denoc calibrate: {error}', file=sys.stderr)
        return NOT_IDENTIFIABLE
    written = _write(args, file, found)
    _show(args, found, written)
    return DOUBTFUL if found.doubts else 0


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
    field = wrench_field(sensor, robot.tree)
    stamp_ns, raw = read_readings(path, sensor.topic, sensor.name, sensor.field, field)
    plateaus = find_plateaus(elapsed(stamp_ns), raw, args.hold)
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
    """Write the calibrated description to the chosen file; return its path, '' without one."""
    paths = calibration_paths(args.sensor, found)
    return write_description(args, file, lambda: edited_description(file, paths))


def _show(args: argparse.Namespace, found: Calibration, written: str) -> None:
    if args.json:
        row = {key: _plain(value) for key, value in vars(found).items()}
        print(json.dumps({'sensor': args.sensor, **row, 'written': written}, indent=2))
        return
    print(f'{args.sensor}: value = gain raw + offset, {found.points} points')
    print(f'gain        {found.gain:.6g} +- {found.gain_error:.2g}')
    print(f'offset      {found.offset:.6g} +- {found.offset_error:.2g}')
    print(f'residual    {found.residual:.3g}')
    for name, share in (('hysteresis', found.hysteresis), ('curvature', found.curvature)):
        print(f'{name:11} {"not known" if math.isnan(share) else f"{share:.2%} of the range"}')
    if math.isfinite(found.noise):
        print(f'noise       {found.noise:.3g}')
    if written:
        print(f'written     {written}')
    for doubt in found.doubts:
        print(f'denoc calibrate: doubtful: {doubt}', file=sys.stderr)


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
