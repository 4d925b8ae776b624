"""Parts of a robot, and a proposed `<flexibility>` block, as numbers and as text."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from denoc_ros.dynamics.assembling import mobility
from denoc_ros.dynamics.elastic.shape_losses import shape_losses
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.singular_inertia import coordinates_without_inertia
from denoc_ros.estimation.observability import observability
from denoc_ros.model.numbers import JOINT_FIELDS
from denoc_ros.model.payloads import six_numbers
from denoc_ros.model.reading.inertia_doubts import inertia_doubts
from denoc_ros.model.tree import Beam, Body, InertialSensor, Joint, Sensor, Tree
from denoc_ros.output_files import plain
from denoc_ros.text_table import Row, cell_text, text_table
from denoc_ros.types import Array

WITHOUT_ROTORS = (
    'no rotor inertia of {}: beyond the modes of the model such a joint moves the root of a beam '
    'only, which has none, and feedback of its rate is unstable with any delay; real gears '
    'reflect gear ratio^2 x rotor inertia: add <actuator joint="NAME" armature="..."/>'
)


@dataclass(frozen=True)
class Posture:
    """A state at rest: its name and its coordinates (n,)."""

    name: str
    q: Array


def summarize(robot: Robot, postures: Sequence[Posture] = ()) -> Row:
    """Return the parts of a robot as plain lists and numbers, ready for JSON.

    Parameters
    ----------
    postures : sequence of Posture
        Where natural frequencies are wanted, beside those with all coordinates zero.

    Returns
    -------
    dict
        `robot`, `mass_kg`, `coordinates`, `links` (payloads included), `payloads`, `joints`,
        `springs`, `beams`, `shapes` (what they lose at each beam's tip and where something
        hangs on it), `sensors`, `loops` (mimic joints too), `mechanism` (what the loops leave to
        move, one row or none),
        `natural_frequencies_hz` (joints held, all coordinates zero; negative: unstable),
        `observability` (of modes and biases by sensors with noise, there), `postures` (both in
        equilibrium at others), `without_rotors` (joints of flexible links that have no rotor
        inertia), and texts: `errors` (none here), `warnings` (the result is doubtful) and `hints`
        (it could be better). Numbers that are infinite stand as None.
    """
    tree = robot.tree
    links = [_link(body, tree.bodies) for body in tree.bodies if body.segment == 1]
    joints = [_joint(body.joint, body.name) for body in tree.bodies if body.joint is not None]
    springs = [row for body in tree.bodies for row in _spring(body.joint)]
    beams = _beams([body for body in tree.bodies if body.segment == 1])
    frequencies = robot.natural_frequencies(np.zeros(robot.n), held=True)
    sensors: tuple[Sensor | InertialSensor, ...] = (*tree.sensors, *tree.inertial_sensors)
    shapes, mechanism = _shapes(robot), _mechanism(robot)
    row = {
        'robot': tree.name,
        'mass_kg': sum(link['mass_kg'] for link in links),
        'coordinates': list(robot.coordinate_names),
        'links': links,
        'payloads': _payloads(tree),
        'joints': joints,
        'springs': springs,
        'beams': beams,
        'flexible': [row for body in tree.bodies for row in _components(body)],
        'shapes': shapes,
        'sensors': [
            {'sensor': s.name, 'type': s.type, 'link': s.link, 'topic': s.topic} for s in sensors
        ],
        **mechanism,
        'natural_frequencies_hz': frequencies,
        'observability': _observability(robot, np.zeros(robot.n)),
        'postures': [
            {
                'at': posture.q[robot.joint_indices],
                'natural_frequencies_hz': robot.natural_frequencies(posture.q, held=True),
                'observability': _observability(robot, posture.q),
            }
            for posture in postures
        ],
        'without_rotors': _without_rotors(tree),
        'errors': [],
        'warnings': [
            *tree.warnings,
            *inertia_doubts(tree),
            *_without_inertia(robot),
            *(f'mechanism: {row["failure"]}' for row in mechanism['mechanism'] if row['failure']),
        ],
        'hints': _hints(tree, shapes),
    }
    return dict(plain(row))


def _without_rotors(tree: Tree) -> list[str]:
    """Return the driven joints without rotor inertia whose link bends, or hangs on one that does.

    At high frequency such a joint sees the root of a beam, which has no inertia.
    """
    found = []
    for body in tree.bodies:
        carrier = tree.bodies[body.attachment.body] if body.attachment.body >= 0 else None
        bends = any(
            each is not None and (each.beam is not None or each.modes is not None)
            for each in (body, carrier)
        )
        joint = body.joint
        if bends and joint is not None and not joint.armature and joint.mimic is None:
            found.append(joint.name)
    return found


def _hints(tree: Tree, shapes: Sequence[Row]) -> list[str]:
    """Return what would make the model better; its results are good without it."""
    found = [
        f'beam {row["link"]!r} ({row["direction"]}): {row["shape"]} shapes lose compliance or '
        f'frequency at {row["at"]}: {row["remedy"]}'
        for row in shapes
        if row['remedy']
    ]
    joints = _without_rotors(tree)
    return [*found, WITHOUT_ROTORS.format(', '.join(joints))] if joints else found


def _without_inertia(robot: Robot) -> list[str]:
    """Return a warning for each joint that moves no inertia; springs without rotors have one."""
    joints = robot.tree.joints
    return [
        f'{"joint" if name in joints else "coordinate"} {name!r}: should move an inertia (forward '
        f'dynamics need it), got none: {remedy}'
        for name, remedy in coordinates_without_inertia(robot).items()
        if name not in joints or joints[name].spring is None
    ]


def _observability(robot: Robot, q: Array) -> list[Row]:
    """Observability of modes and biases by the sensors at rest at q (n,)."""
    return [
        {
            'state': state.name,
            'hz': state.frequency or None,
            'uncertainty_left': state.left,
            'observed': 'yes' if state.observable else 'no',
        }
        for state in observability(robot, q)
    ]


def _mechanism(robot: Robot) -> Row:
    """Return the loops and mimic joints, and the remaining degrees of freedom."""
    if not robot.constraint_names:
        return {'loops': [], 'mechanism': []}
    found = mobility(robot)
    described = {loop.name: loop for loop in robot.tree.loops}
    loops = []
    for constraint in found.constraints:
        loop = described.get(constraint.name)
        loops.append(
            {
                'loop': constraint.name,
                'type': 'mimic' if loop is None else loop.type,
                'parent': '' if loop is None else loop.parent.link,
                'child': '' if loop is None else loop.child.link,
                'error_at_zero': constraint.error,
                'rows': constraint.rows,
                'rank': constraint.rank,
                'redundant_rows': constraint.redundant,
            }
        )
    mechanism = {
        'rows': found.rows,
        'rank': found.rank,
        'redundant_rows': found.rows - found.rank,
        'degrees_of_freedom': found.degrees_of_freedom,
        'singular': found.rank < found.usual_rank,
        'closed_at': None if found.failure else found.q,
        'failure': found.failure,
    }
    return {'loops': loops, 'mechanism': [mechanism]}


def _joint_name(body: Body) -> str:
    if body.floating:
        return f'{body.floating} (floating)'
    return '(fixed)' if body.joint is None else body.joint.name


def _link(body: Body, bodies: Sequence[Body]) -> Row:
    """Row of a link, from its first body and all of the robot's."""
    rigid = sum(each.inertia.mass for each in bodies if each.link == body.name)
    carrier = bodies[body.attachment.body] if body.attachment.body >= 0 else None
    beam = body.beam
    mass = rigid + (0.0 if beam is None else beam.mass_per_length * beam.whole_length)
    mass += 0.0 if body.modes is None else body.modes.link.mass
    return {
        'link': body.name,
        'on': 'base' if carrier is None else carrier.link,
        'station_m': float(body.attachment.station + (0.0 if carrier is None else carrier.start)),
        'joint': _joint_name(body),
        'mass_kg': float(mass),
        'beam_mass_kg': float(mass - rigid),
        'modes': body.amplitudes if beam is None else beam.segments * sum(beam.modes),
    }


def _payloads(tree: Tree) -> list[Row]:
    return [
        {
            'link': link,
            'mass_kg': payload.mass,
            'com_m': payload.com,
            'inertia_kg_m2': six_numbers(payload.inertia),
        }
        for link, payload in tree.payloads.items()
    ]


def _joint(joint: Joint, link: str) -> Row:
    return {
        'joint': joint.name,
        'type': 'continuous' if joint.continuous else joint.kind.name.lower(),
        'link': link,
        'axis': joint.axis,
        **vars(joint.limits),
        **{name: getattr(joint, name) for name in JOINT_FIELDS},
        'mimics': '' if joint.mimic is None else joint.mimic.leader,
    }


def _spring(joint: Joint | None) -> list[Row]:
    spring = None if joint is None else joint.spring
    if joint is None or spring is None:
        return []
    return [{'joint': joint.name, **vars(spring), 'armature': joint.armature}]


def _beams(bodies: Sequence[Body]) -> list[Row]:
    """Return the beams; their segments where one has several."""
    found = [(body.beam, body.name) for body in bodies if body.beam is not None]
    rows = [_beam(beam, link) for beam, link in found]
    if any(beam.segments > 1 for beam, _ in found):
        for row, (beam, _) in zip(rows, found, strict=True):
            row['segments'] = beam.segments
    if any(beam.varies for beam, _ in found):
        for row, (beam, _) in zip(rows, found, strict=True):
            row['numbers'] = 'means along the beam' if beam.varies else 'all along'
    return rows


def _components(body: Body) -> Iterator[Row]:
    """Yield a table's row of a link with component modes."""
    if (modes := body.modes) is None:
        return
    link = modes.link
    held = np.sqrt(modes.stiffness / link.modal_mass) / (2.0 * math.pi)
    lost = [float(np.max(each)) for each in link.left_out.values()]
    yield {
        'link': body.name,
        'file': modes.file.rpartition('/')[2],
        'modes': modes.count,
        'points': len(link.points),
        'second_order_terms': len(link.pairs),
        'held_hz': [float(f'{value:.6g}') for value in held],
        'frames': ', '.join(link.frames),
        'strain_points': len(link.strain),
        'compliance_lost_percent': max(lost, default=None),
        'source': link.source,
    }


def _beam(beam: Beam, link: str) -> Row:
    y, z, torsion = beam.y, beam.z, beam.torsion
    return {
        'link': link,
        'length_m': float(beam.whole_length),
        'mass_per_length': float(beam.mass_per_length),
        'ei_y': None if y is None else float(y.stiffness),
        'modes_y': beam.modes[0],
        'ei_z': None if z is None else float(z.stiffness),
        'modes_z': beam.modes[1],
        'gj': None if torsion is None else float(torsion.stiffness),
        'modes_torsion': beam.modes[2],
    }


def _shapes(robot: Robot) -> list[Row]:
    """Losses of each beam's shapes, in percent of the beam's own compliance."""

    def percent(share: float | None) -> float | None:
        return None if share is None else round(100.0 * share, 4) + 0.0

    return [
        {
            'link': loss.link,
            'direction': loss.direction,
            'shape': loss.shape,
            'modes': loss.modes,
            'at': loss.at,
            'station_m': float(loss.station),
            'force_lost_percent': percent(loss.force),
            'moment_lost_percent': percent(loss.moment),
            'frequency_off_percent': percent(loss.frequency),
            'remedy': loss.remedy,
        }
        for loss in shape_losses(robot)
    ]


def robot_text(summary: Mapping[str, Any]) -> str:
    """Return the parts of a robot as tables for a terminal."""
    parts = [
        f'{summary["robot"]}: {summary["mass_kg"]:.6g} kg, '
        f'{len(summary["coordinates"])} coordinates'
    ]
    tables = (
        'links', 'payloads', 'joints', 'springs', 'beams', 'flexible', 'shapes', 'sensors',
        'loops', 'mechanism',
    )  # fmt: skip
    for title in tables:
        if summary[title]:
            parts.append(f'{title}\n{text_table(summary[title])}')
    frequencies = summary['natural_frequencies_hz']
    if frequencies:
        listed = '  '.join(cell_text(value) for value in frequencies)
        parts.append(f'natural frequencies [Hz], joints held at zero\n  {listed}')
    if summary['observability']:
        parts.append(f'observability, joints held at zero\n{text_table(summary["observability"])}')
    for posture in summary['postures']:
        at = ', '.join(f'{value:g}' for value in posture['at'])
        listed = '  '.join(cell_text(value) for value in posture['natural_frequencies_hz'])
        parts.append(
            f'natural frequencies [Hz], joints held at ({at}), in equilibrium\n  {listed}'
        )
        if posture['observability']:
            table = text_table(posture['observability'])
            parts.append(f'observability, joints held at ({at}), in equilibrium\n{table}')
    if summary['without_rotors']:
        parts.append(WITHOUT_ROTORS.format(', '.join(summary['without_rotors'])))
    return '\n\n'.join(parts)
