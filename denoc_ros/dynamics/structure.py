"""Structure of a robot: DeNOC matrices, sections, sensor rows."""

from __future__ import annotations

import numpy as np
import scipy.linalg

from denoc_ros.dynamics.elastic.section import (
    AnySection,
    ComponentSection,
    Section,
    SegmentedSection,
)
from denoc_ros.dynamics.robot_model import RobotModel
from denoc_ros.dynamics.rotations import cross_matrices
from denoc_ros.errors import StateError
from denoc_ros.kernels.dynamics import world
from denoc_ros.kernels.layout import layout
from denoc_ros.model.beams.segments import WholeBeam, whole_beams
from denoc_ros.model.tree import Sensor
from denoc_ros.types import Array


def whole_beam(robot: RobotModel, link: str) -> WholeBeam:
    """Return a flexible link's beam.

    Raises
    ------
    StateError
        The link is none of the robot's flexible ones.
    """
    beams = whole_beams(robot.tree)
    for beam in beams:
        if beam.link == link:
            return beam
    flexible = [beam.link for beam in beams]
    if component_body(robot, link) is not None:
        raise StateError(f'link must be one with a <beam> of {flexible}, got <flexible> {link!r}')
    raise StateError(f'link must be a flexible one of {flexible}, got {link!r}')


def component_body(robot: RobotModel, link: str) -> int | None:
    """Return the index of the body of a link with component modes, None of any other."""
    bodies = enumerate(robot.tree.bodies)
    return next((k for k, body in bodies if body.name == link and body.modes is not None), None)


def amplitudes(robot: RobotModel, link: str) -> slice:
    """Return the indices of a flexible link's amplitudes; `link/2` is its second segment alone."""
    for index, body in enumerate(robot.tree.bodies):
        if body.name == link and body.segment > 1:
            return body_amplitudes(robot, index)
    if (component := component_body(robot, link)) is not None:
        return body_amplitudes(robot, component)
    beam = whole_beam(robot, link)
    first = body_amplitudes(robot, beam.first).start
    return slice(first, first + beam.segments * beam.modes)


def body_amplitudes(robot: RobotModel, index: int) -> slice:
    """Return the indices of a body's amplitudes, of one segment if a link has several."""
    row = robot.arrays.topology[robot.arrays.body_rows[index]].astype(int)
    first = int(row[layout.COORDINATE] + row[layout.JOINT])
    return slice(first, first + int(row[layout.MODES]))


def find_section(robot: RobotModel, link: str, station: float | None) -> tuple[AnySection, slice]:
    """Return a section of a link's beam (default its tip) and its amplitudes' slice.

    Of a link with component modes: the frame that is farthest from its origin, no station.
    """
    if (index := component_body(robot, link)) is not None:
        modes = robot.tree.bodies[index].modes
        assert modes is not None
        if station is not None or not modes.tip:
            got = 'no frame' if station is None else f'{station}'
            rule = 'station must be left out, and its file have a frame'
            raise StateError(f'flexible link {link!r}: {rule}, got {got}')
        found = ComponentSection(modes.link, modes.tip, robot.geometric_stiffness)
        return found, body_amplitudes(robot, index)
    beam = whole_beam(robot, link)
    at = beam.length if station is None else float(station)
    if not 0.0 <= at <= beam.length:
        raise StateError(f'station of {link!r} must be in [0, {beam.length}] m, got {at}')
    own, geometric = amplitudes(robot, link), robot.geometric_stiffness
    if beam.segments == 1:
        return Section(beam.segment, at, geometric), own
    return SegmentedSection(beam.beams, at, geometric), own


def sensor_rows(robot: RobotModel) -> Array:
    """Return the derivative (sensors, n) of all sensors' values by the coordinates.

    Of a deflection sensor on a link of several segments: where the link bends little.
    """
    rows = np.zeros((len(robot.tree.sensors), robot.n))
    for row, sensor in zip(rows, robot.tree.sensors, strict=True):
        first = body_amplitudes(robot, sensor.body).start
        row[first : first + len(sensor.row)] = sensor.row
    return rows


def composed_sensors(robot: RobotModel) -> list[tuple[int, Sensor]]:
    """Return the places and sensors whose value is not linear in the coordinates."""
    return [
        (place, sensor)
        for place, sensor in enumerate(robot.tree.sensors)
        if sensor.quantity == 'deflection' and len(sensor.row) > sum(_modes(robot, sensor))
    ]


def _modes(robot: RobotModel, sensor: Sensor) -> tuple[int, int, int]:
    beam = robot.tree.bodies[sensor.body].beam
    assert beam is not None
    return beam.modes


def _blocks(robot: RobotModel, i: int) -> tuple[Array | None, Array]:
    """Return twist propagation A (6 + m_i, 6 + m_parent) and P (6 + m_i, k_i) of row i."""
    row = robot.arrays.topology[i].astype(int)
    constants, work = robot.constants, robot.work
    modes = int(row[layout.MODES])
    joint = int(row[layout.JOINT])
    p = np.zeros((6 + modes, joint + modes))
    if joint:
        at = int(row[layout.BODY_CONSTANTS]) + layout.AXIS
        p[:6, 0] = constants[at : at + 6]
    p[6:, joint:] = np.eye(modes)
    parent = int(row[layout.PARENT])
    if parent == 0:
        return None, p
    columns = int(robot.arrays.topology[parent, layout.MODES])
    six = np.eye(6, 6 + columns)  # twist of the section from that of its body
    if row[layout.SECTION] > 0:
        at = int(row[layout.SECTION_WORK])
        six[:3, 3:6] = -cross_matrices(work[at : at + 3])
        each = work[at + layout.COLUMNS : at + layout.COLUMNS + 6 * columns]
        six[:, 6:] = each.reshape(columns, 6).T
    at = int(row[layout.WORK])
    rotation = work[at : at + 9].reshape(3, 3)
    arm = cross_matrices(work[at + layout.ARM : at + layout.ARM + 3])
    a = np.zeros((6 + modes, 6 + columns))
    a[:3] = rotation.T @ (six[:3] - arm @ six[3:])
    a[3:6] = rotation.T @ six[3:]
    return a, p


def _public_axes(robot: RobotModel, i: int) -> Array:
    """Return the turn (6 + m, 6 + m) of row i's twist from the kernels' axes to the body frame."""
    turn: Array = np.eye(6 + int(robot.arrays.topology[i, layout.MODES]))
    turn[:3, :3] = turn[3:6, 3:6] = robot.arrays.axes[i - 1]
    return turn


def denoc_matrices(robot: RobotModel, q: Array) -> tuple[Array, Array]:
    """Return the dense N_l (twists of all bodies by bodies) and N_d (block diagonal)."""
    topology, bodies = robot.arrays.topology, robot.arrays.bodies
    world.place_bodies(robot.handle, q)
    sizes = 6 + topology[1 : bodies + 1, layout.MODES].astype(int)
    edges = np.concatenate([[0, 0], np.cumsum(sizes)])
    n_l = np.eye(int(edges[-1]))
    diagonal = []
    for i in range(1, bodies + 1):
        a, p = _blocks(robot, i)
        turn = _public_axes(robot, i)
        diagonal.append(turn @ p)
        if a is None:
            continue
        a = turn @ a @ _public_axes(robot, int(topology[i, layout.PARENT])).T
        parent = int(topology[i, layout.PARENT])
        rows = slice(edges[i], edges[i + 1])
        above = slice(edges[parent], edges[parent + 1])
        n_l[rows, : edges[parent + 1]] = a @ n_l[above, : edges[parent + 1]]
    return n_l, np.asarray(scipy.linalg.block_diag(*diagonal), dtype=np.float64)
