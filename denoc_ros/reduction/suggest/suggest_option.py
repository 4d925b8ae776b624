"""`denoc check --suggest`: a proposed `<flexibility>` block for a plain URDF."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.cli.arguments import add_option
from denoc_ros.cli.verb_result import VerbResult
from denoc_ros.cli.verbs import DOUBTFUL
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.output_files import write_new
from denoc_ros.reduction.suggest.suggested_beam import BeamSuggestion
from denoc_ros.reduction.suggest.suggestion import Suggestion, suggest_flexibility
from denoc_ros.text_table import Row, cell_text, text_table

COLUMNS = ('link', 'length_m', 'ei_y', 'ei_z', 'ei_low', 'ei_high', 'gj', 'modes')


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    group = parser.add_argument_group('a plain URDF becomes flexible')
    add_option(
        group,
        '--suggest',
        'propose beams for its links, from their inertia, joints, geometry and a material',
    )
    add_option(
        group,
        '--material NAME',
        'material: aluminium (the default), steel, titanium, magnesium, cfrp or gfrp',
    )
    add_option(
        group,
        '--link NAME',
        'make this link flexible in any case; repeatable; default: all links that bend enough',
        action='append',
    )
    add_option(
        group,
        '--bandwidth HZ',
        "bandwidth of the robot's control, default 10: links with a natural frequency "
        'below five times this become flexible, with modes up to ten times this',
        type=float,
    )
    add_option(
        group,
        '--gears NAME',
        'propose springs for its joints as well, by the effort limits, as gears of this '
        'kind would be: strain_wave, cycloidal or planetary; an assumption',
    )


def run(args: argparse.Namespace, file: Path | str) -> VerbResult:
    """Propose and write; exit status 2 if no link bends enough."""
    wishes: dict[str, Any] = {'links': args.link, 'gravity': math.hypot(*args.gravity)}
    wishes |= {
        name: getattr(args, name)
        for name in ('material', 'bandwidth', 'gears')
        if getattr(args, name) is not None
    }
    suggestion = suggest_flexibility(file, **wishes)
    robot = load_robot(suggestion.text, gravity=tuple(args.gravity))
    row = summarize_suggestion(suggestion, robot)
    proposed = bool(suggestion.springs) or any(beam.worth for beam in suggestion.beams)
    if args.output and proposed:
        write_new(args.output, suggestion.text)
        row['written'] = str(args.output)
    warnings = [f'denoc check: warning: {warning}' for warning in robot.tree.warnings]
    return VerbResult(row, [suggestion_text(row)], 0 if proposed else DOUBTFUL, warnings)


def summarize_suggestion(suggestion: Suggestion, robot: Robot) -> Row:
    """Return a proposal as plain lists and numbers ready for JSON.

    Returns
    -------
    dict
        `robot`, `material`, `beams` (all links that could be one, with `proposed`), `refused`
        (links that could not, with `why`), `natural_frequencies_hz` of the proposed robot
        (joints held at zero), `without_armature` (joints whose drives have no rotor inertia)
        `gears` (None: not asked for), `springs` (assumed; `armature` None: the robot says it),
        `stiff` (joints without a proposal, with `why`) and `written`, the file or None.
    """
    material = suggestion.material
    frequencies = robot.natural_frequencies(np.zeros(robot.n), held=True)
    return {
        'robot': robot.tree.name,
        'material': {
            'name': material.name,
            'grade': material.grade,
            'e_pa': material.e,
            'g_pa': material.g,
            'density': material.density,
            'source': material.source,
            'damping_ratio': material.damping_text,
        },
        'beams': [_suggested_beam(beam) for beam in suggestion.beams],
        'refused': [{'link': link, 'why': why} for link, why in suggestion.refused.items()],
        'natural_frequencies_hz': [float(value) for value in frequencies],
        'without_armature': [
            name
            for name, joint in robot.tree.joints.items()
            if not joint.armature and not joint.mimic
        ],
        'gears': _gears(suggestion),
        'springs': [vars(spring) for spring in suggestion.springs],
        'stiff': [{'joint': joint, 'why': why} for joint, why in suggestion.stiff.items()],
        'written': None,
    }


def _gears(suggestion: Suggestion) -> Row | None:
    family = suggestion.gears
    if family is None:
        return None
    told = ('name', 'description', 'source', 'spread')
    return {name: getattr(family, name) for name in told}


def _suggested_beam(beam: BeamSuggestion) -> Row:
    stiff = beam.stiffness
    effort = beam.effort_deflection
    return {
        'link': beam.link,
        'proposed': beam.worth,
        'reason': beam.reason,
        'length_m': beam.line.length,
        'along': [float(value) for value in beam.line.frame[:3, 0]],
        'mass_per_length': beam.mass_per_length,
        'beam_share': beam.beam_share,
        'section': stiff.section,
        'ei_y': stiff.ei_y,
        'ei_z': stiff.ei_z,
        'ei_low': stiff.ei_range[0],
        'ei_high': stiff.ei_range[1],
        'gj': stiff.gj,
        'polar_inertia': beam.polar_inertia,
        'modes': list(beam.modes),
        'damping_ratio': beam.damping_ratio,
        'first_hz': beam.frequency,
        'sag_m': beam.sag,
        'effort_deflection_m': effort if math.isfinite(effort) else None,
        'confidence': stiff.confidence,
        'why': stiff.why,
    }


def suggestion_text(row: Row) -> str:
    """Return a proposal for a terminal."""
    material = row['material']
    proposed = [beam for beam in row['beams'] if beam['proposed']]
    considered = len(row['beams']) + len(row['refused'])
    parts = [
        f'{row["robot"]}: {len(proposed)} of {considered} moving links proposed as beams of '
        f'{material["name"]} '
        f'({material["grade"]}: E {material["e_pa"]:.4g} Pa, G {material["g_pa"]:.4g} Pa, '
        f'{material["density"]:.4g} kg/m^3; {material["source"]})'
    ]
    if proposed:
        rows = [
            {**{k: b[k] for k in COLUMNS}, 'alone_hz': f'~{b["first_hz"]:.2g}'} for b in proposed
        ]
        parts.append('beams\n' + text_table(rows))
        parts.append('\n'.join(_explained(beam) for beam in proposed))
    rigid = [{'link': b['link'], 'why': b['reason']} for b in row['beams'] if not b['proposed']]
    if rigid or row['refused']:
        parts.append('left rigid\n' + text_table(rigid + row['refused']))
    parts += _springs_text(row)
    if row['natural_frequencies_hz']:
        listed = '  '.join(cell_text(value) for value in row['natural_frequencies_hz'])
        parts.append(
            'natural frequencies [Hz] of the robot as proposed, joints held at zero (alone_hz: '
            f'roughly, one beam with a mass at its tip)\n  {listed}'
        )
    if proposed:
        ratio = proposed[0]['damping_ratio']
        parts.append(f'damping ratio {ratio:g} is assumed, between {material["damping_ratio"]}')
        if row['without_armature']:
            parts.append(
                f'no rotor inertia yet of {", ".join(row["without_armature"])}: '
                'add <actuator joint="NAME" armature="gear ratio^2 x rotor inertia"/>'
            )
    if row['written']:
        parts.append(f'{row["written"]}: written')
    elif not proposed and not row['springs']:
        parts.append('nothing is written: --link NAME makes a link flexible anyway')
    return '\n\n'.join(parts)


def _springs_text(row: Row) -> list[str]:
    """Proposals for the joints, for a terminal."""
    gears = row['gears']
    if gears is None:
        return []
    parts = []
    if row['springs']:
        parts.append(
            f'springs, assumed: {gears["description"]}, {gears["source"]}; single gears differ by '
            f"a factor of {gears['spread']:g}: use your gears' data sheets\n"
            + text_table(row['springs'])
        )
    if row['stiff']:
        parts.append('joints left stiff\n' + text_table(row['stiff']))
    return parts


def _explained(beam: Row) -> str:
    return (
        f'  {beam["link"]}: {beam["reason"]}; {beam["section"]}, '
        f'{beam["beam_share"]:.0%} of its mass in the beam\n'
        f'    EI: {beam["confidence"]} confidence, {beam["why"]}'
    )
