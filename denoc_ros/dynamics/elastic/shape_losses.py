"""How much too stiff the shape functions make each beam: compliance and natural frequencies."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.model.beams.segments import WholeBeam, whole_beams
from denoc_ros.model.beams.shapes import merged_edges, panels
from denoc_ros.model.overrides import with_overrides
from denoc_ros.model.tree import Beam, Deformation
from denoc_ros.types import Array

FINER = 8  # segments of a beam whose lowest frequencies are right to 1e-4
CLAMPED = ('clamped-free', 'craig-bampton')  # shapes whose link frame is tangent to the root
PANELS = 16  # of a beam whose section varies
DOUBTFUL = 0.02  # share of the compliance, or of a frequency, that calls for a remedy


@dataclass(frozen=True)
class ShapeLoss:
    """Errors of one deformation of a beam at a station, as shares."""

    link: str
    direction: str  # y, z or torsion
    shape: str
    modes: int
    at: str  # `tip`, or what hangs there
    station: float  # on the beam [m]
    # shares that are missing: of the deflection under a force there (None for torsion, for shapes
    # that do not clamp the root, and for segments), of the rotation under a moment or torque there
    force: float | None
    moment: float | None
    # largest relative error of the robot's lowest natural frequencies, joints held at zero, that
    # goes away when this beam alone is divided in `FINER` segments: as many frequencies as there
    # are flexible links
    frequency: float | None
    remedy: str  # empty where nothing is lost that matters to what hangs there


def shape_losses(robot: Robot) -> list[ShapeLoss]:
    """Losses of the shapes of each beam, at its tip and at its children."""
    beams = whole_beams(robot.tree)
    lowest = robot.natural_frequencies(np.zeros(robot.n))[: len(beams)]
    found = []
    for beam in beams:
        finer = None if beam.segments > 1 else _frequency_error(robot, beam, lowest)
        hung = _stations(robot, beam)
        for at, station in {'tip': beam.length, **hung}.items():
            for direction, part in _parts(beam.segment):
                row = replace(_loss(beam, direction, part, at, station), frequency=finer)
                found.append(row if hung and at == 'tip' else _judged(row, bool(hung)))
    return found


def _frequency_error(robot: Robot, beam: WholeBeam, own: Array) -> float:
    """Return the largest relative difference of the lowest frequencies from a divided beam's."""
    tree = with_overrides(robot.tree, {f'beam.{beam.link}.segments': FINER})
    divided = Robot(tree, robot.gravity, robot.geometric_stiffness)
    exact = divided.natural_frequencies(np.zeros(divided.n))[: len(own)]
    stable = (own > 0.0) & (exact > 0.0)
    return float(np.max(np.abs(own[stable] / exact[stable] - 1.0), initial=0.0))


def _parts(beam: Beam) -> list[tuple[str, Deformation]]:
    parts = (('y', beam.y), ('z', beam.z), ('torsion', beam.torsion))
    return [(name, part) for name, part in parts if part is not None and part.modes]


def _stations(robot: Robot, beam: WholeBeam) -> dict[str, float]:
    """Return the stations [m] where masses and loops hang, by their names."""
    bodies = robot.tree.bodies
    own = range(beam.first, beam.first + beam.segments)
    loaded = _loaded(robot)
    hung = [(bodies[k].name, bodies[k].attachment) for k in loaded if bodies[k].segment == 1]
    hung += [
        (side.frame, robot.tree.frames[side.frame])
        for loop in robot.tree.loops
        for side in (loop.parent, loop.child)
    ]
    stations = {}
    for name, at in hung:
        station = at.station if at.body < 0 else at.station + bodies[at.body].start
        if at.body in own and station > 0.0:
            stations[name] = station
    return stations


def _loaded(robot: Robot) -> list[int]:
    """Return the bodies that have a mass, or that carry one."""
    bodies = robot.tree.bodies
    loaded = {k for k, body in enumerate(bodies) if body.inertia.mass > 0.0 or body.amplitudes}
    for k in sorted(loaded, reverse=True):
        while (k := bodies[k].attachment.body) >= 0:
            loaded.add(k)
    return sorted(loaded)


def _loss(
    beam: WholeBeam, direction: str, part: Deformation, at: str, station: float
) -> ShapeLoss:
    force = moment = None
    x = np.array([station])
    if beam.segments == 1 and direction == 'torsion':
        value, (_, turn) = part.shapes.values(x)[0], _compliance(part, beam.length, station)
        moment = 1.0 - float(value @ (value / part.modal_stiffness)) / turn
    elif beam.segments == 1 and part.shape in CLAMPED:
        value, slope = part.shapes.values(x)[0], part.shapes.slopes(x)[0]
        bend, turn = _compliance(part, beam.length, station)
        force = 1.0 - float(value @ (value / part.modal_stiffness)) / bend
        moment = 1.0 - float(slope @ (slope / part.modal_stiffness)) / turn
    shape = part.shape or 'sine'
    return ShapeLoss(beam.link, direction, shape, part.modes, at, station, force, moment, None, '')


def _compliance(part: Deformation, length: float, station: float) -> tuple[float, float]:
    """Return the deflection [m/N] and rotation [rad/N m] of a clamped beam by loads at a station.

    int (station - x)^2 / EI dx and int 1 / EI dx up to the station.
    """
    if part.along.uniform:
        stiffness = float(part.stiffness_at(np.zeros(1))[0])
        return station**3 / (3.0 * stiffness), station / stiffness
    edges = merged_edges(part.along.breaks, np.arange(PANELS + 1) / PANELS)
    inboard = [x for x in edges if x * length < station]
    x, weight = panels(length, [*inboard, station / length], 16)
    weight = weight / part.stiffness_at(x / length)
    return float(np.sum(weight * (station - x) ** 2)), float(np.sum(weight))


def _judged(loss: ShapeLoss, carries: bool) -> ShapeLoss:
    """Return the loss with its remedy."""
    lost = max(loss.force or 0.0, loss.moment or 0.0) if carries else 0.0
    if max(lost, loss.frequency or 0.0) <= DOUBTFUL:
        return loss
    if loss.direction != 'torsion' and loss.shape == 'clamped-free' and carries:
        return replace(loss, remedy='shape="craig-bampton"' + (' modes="2"' * (loss.modes < 2)))
    return replace(loss, remedy=f'modes="{loss.modes + 1}" or segments="2"')
