"""`denoc identify apply`, `compare`, `postures`: results into robots, compared, as a table."""

from __future__ import annotations

import argparse
import dataclasses
import math
from pathlib import Path

import yaml

from denoc_ros.cli.arguments import add_json, add_option, add_output, given_file
from denoc_ros.cli.verb_result import VerbResult
from denoc_ros.cli.verbs import DOUBTFUL
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.errors import ConfigError
from denoc_ros.identification.apply import compare_results, overrides_of_results, posture_table
from denoc_ros.identification.identification_result import read_result
from denoc_ros.identification.verbs.identify_options import Action, add_robot_options
from denoc_ros.model.overrides import edited_description
from denoc_ros.output_files import plain, require_new, write_text
from denoc_ros.text_table import text_table


def _add_results(parser: argparse.ArgumentParser) -> None:
    add_option(parser, 'results RESULT', 'a result.yaml, or its folder', nargs='+', type=Path)
    add_json(parser)


def _add_written(parser: argparse.ArgumentParser, form: str, file: str) -> None:
    """Declare the options of files that are written from results."""
    _add_results(parser)
    add_output(parser, form, f'{file}, must not exist', required=True)
    add_option(parser, '--doubtful', 'use doubtful modes too')


def _add_apply(parser: argparse.ArgumentParser) -> None:
    _add_written(parser, 'URDF', 'URDF file to write')
    add_option(parser, '--robot URDF', 'URDF file of the robot', required=True)
    add_option(parser, '--joint', 'joint to which the friction belongs', '')
    add_robot_options(parser, robot=False)


def _apply(
    results: list[Path],
    output: Path,
    robot: str,
    gravity: tuple[float, float, float],
    at: dict[str, float],
    held: bool,
    doubtful: bool,
    joint: str,
) -> VerbResult:
    require_new(output)
    read = [read_result(path) for path in results]
    arm = load_robot(given_file(robot, 'robot'), gravity=gravity)
    overrides = overrides_of_results(arm, read, at, held, doubtful, joint)
    write_text(output, edited_description(arm.tree.source, overrides))
    lines = [f'{output}: {robot} with']
    for path, value in overrides.items():
        listed = value if isinstance(value, list) else [value]
        lines.append(f'  {path}: {" ".join(f"{number:.6g}" for number in listed)}')
    return VerbResult({'output': str(output), 'overrides': overrides}, lines)


def _compare(results: list[Path]) -> VerbResult:
    """Compare; exit status 2 when runs differ by more than their intervals let expect."""
    compared = compare_results([read_result(path) for path in results])
    rows = [
        {
            'f [Hz]': mode.frequency_hz,
            'runs': f'{len(mode.runs)} of {len(results)}',
            'zeta': mode.damping_ratio,
            'deviation': mode.damping_deviation,
            'expected': mode.expected_deviation,
            'repeatability': mode.repeatability,
            'of zeta': _percent(mode.repeatability / mode.damping_ratio),
            'consistent': 'yes' if mode.consistent else 'no',
        }
        for mode in compared
    ]
    modes = [{**dataclasses.asdict(mode), 'consistent': mode.consistent} for mode in compared]
    document = {'results': list(map(str, results)), 'modes': modes}
    status = 0 if all(mode.consistent for mode in compared) else DOUBTFUL
    return VerbResult(document, [text_table(plain(rows))] if rows else [], status)


def _postures(results: list[Path], output: Path, doubtful: bool) -> VerbResult:
    """Write the table; exit status 2 where a doubtful mode is in it."""
    require_new(output)
    if output.suffix not in ('.yaml', '.yml'):
        raise ConfigError('postures', [f'--output must end in .yaml, got {output.name!r}'])
    read = [(path, read_result(path)) for path in results]
    table, good = posture_table(read, doubtful, str(output))
    values = table.text_values()
    write_text(output, yaml.safe_dump(values, sort_keys=False, default_flow_style=None))
    rows = [
        {
            **{name: f'{q:.4g}' for name, q in zip(table.joints, posture, strict=True)},
            'f [Hz]': ' '.join(f'{value:.4g}' for value in frequency),
            'zeta': ' '.join(f'{value:.4g}' for value in damping),
        }
        for posture, frequency, damping in zip(
            table.positions, table.frequencies, table.ratios, strict=True
        )
    ]
    lines = [text_table(rows), f'{len(rows)} postures in {output}']
    document = {'output': str(output), **values}
    return VerbResult(document, lines, 0 if good else DOUBTFUL)


def _percent(value: float) -> str:
    return f'{100.0 * value:.2g} %' if math.isfinite(value) else '-'


DECLARED = (
    Action(
        'apply',
        'Compute the damping with which the robot has the identified modes, and write it into its '
        '<flexibility> block; or write the friction of a joint into its <dynamics>. Nothing else '
        'in the file changes. Several results of modes are combined.',
        _add_apply,
        _apply,
    ),
    Action(
        'compare',
        'Compare the modes of several results: mean, standard deviation between runs, largest '
        'difference of two runs in 95 %% of cases. Exit status 2 if runs differ by more than '
        'their intervals allow.',
        _add_results,
        _compare,
    ),
    Action(
        'postures',
        'Write the modes of several results, one posture each, into the table that `denoc shape '
        '--mode-table` and the shaper node (`mode_table`) read. The robot needs no beams. A '
        'result has the posture of `--at` or of the joint states of its bag, and the modes that '
        'its verdict is of (`--band`, `--modes`). Exit status 2 if one of them is doubtful.',
        lambda parser: _add_written(parser, 'FILE', 'table of modes to write (.yaml)'),
        _postures,
    ),
)
