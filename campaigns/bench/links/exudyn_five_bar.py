"""The five-bar FFFF in free fall beside Exudyn's nonlinear finite elements: results, then times.

    python -m campaigns five-bar

Exudyn takes every link as absolute-nodal-coordinate beam elements that also stretch, and
integrates by an implicit generalized-alpha method of fixed step; ours is `dn.simulate` with
craig-bampton shapes, its integrator compiled. They take turns; the least time of each counts.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass
from typing import Any

import exudyn
import numpy as np
from exudyn.beams import GenerateBeamElementsAlongLine
from exudyn.itemInterface import (
    MarkerBodyPosition,
    MarkerNodePosition,
    ObjectANCFCable2D,
    ObjectGround,
    ObjectJointRevolute2D,
    SensorNode,
)
from mechanism_runs import book_fall, loaded

from denoc_ros.types import Array

ELEMENTS = 8  # a link
STEP = 1e-4  # s, of Exudyn: its deflections are then right to 1.3 % of their peak
FINE = 2.5e-5  # s, of the run that ours is judged by
SHAPES = 3  # a link, craig-bampton
TOLERANCES = {'rtol': 1e-5, 'atol': 1e-5}
EARLY = 0.6  # s, over which the results are compared
MASS_PER_LENGTH = 0.6  # kg/m
MODULUS, RADIUS = 2.0e11, 0.010
JOINTS = ('joint_1', 'joint_2', 'joint_3', 'joint_4')
LINKS = ('link_1', 'link_2', 'link_3', 'link_4')


@dataclass(frozen=True)
class Fall:
    """A run: times (k,), joint angles and tip deflections (k, 4), wall time, energy drift."""

    t: Array
    angles: Array
    deflections: Array
    seconds: float
    drift: float


@dataclass(frozen=True)
class Comparison:
    """Both runs' times [s]; how far ours is from Exudyn's, finely stepped, in the first 0.6 s."""

    exudyn_s: float
    ours_s: float
    ratio: float
    drift: float
    angle: float  # rad
    deflection: float  # of the peak


def direction(angle: float) -> Array:
    return np.array([np.cos(angle), np.sin(angle), 0.0])


def lines() -> dict[str, tuple[Array, Array]]:
    """Ends of the four links at the book's start."""
    left, right = np.zeros(3), np.array([1.0, 0.0, 0.0])
    elbow, other = left + direction(np.deg2rad(108)), right + direction(np.deg2rad(72))
    tip = elbow + direction(np.deg2rad(36))
    ends = (left, elbow), (elbow, tip), (right, other), (other, tip)
    return dict(zip(LINKS, ends, strict=True))


def exudyn_fall(times: Array, elements: int = ELEMENTS, step: float = STEP) -> Fall:
    """Free fall by Exudyn's beam elements."""
    container = exudyn.SystemContainer()
    system = container.AddSystem()
    ground = system.AddObject(ObjectGround())
    beam = ObjectANCFCable2D(
        massPerLength=MASS_PER_LENGTH,
        bendingStiffness=MODULUS * np.pi * RADIUS**4 / 4,
        axialStiffness=MODULUS * np.pi * RADIUS**2,
    )
    nodes, places = {}, lines()
    for name, (root, tip) in places.items():
        made = GenerateBeamElementsAlongLine(
            system, list(root), list(tip), elements, beam, gravity=[0, -9.81, 0]
        )
        nodes[name] = made['nodes'][0], made['nodes'][-1]

    def on_node(link: str, end: int) -> Any:
        return system.AddMarker(MarkerNodePosition(nodeNumber=nodes[link][end]))

    def on_ground(place: Array) -> Any:
        return system.AddMarker(MarkerBodyPosition(bodyNumber=ground, localPosition=list(place)))

    pins = [
        (on_ground(places['link_1'][0]), on_node('link_1', 0)),
        (on_ground(places['link_3'][0]), on_node('link_3', 0)),
        (on_node('link_1', 1), on_node('link_2', 0)),
        (on_node('link_3', 1), on_node('link_4', 0)),
        (on_node('link_2', 1), on_node('link_4', 1)),
    ]
    for pin in pins:
        system.AddObject(ObjectJointRevolute2D(markerNumbers=list(pin)))
    sensors = {
        link: [
            system.AddSensor(
                SensorNode(
                    nodeNumber=node,
                    outputVariableType=exudyn.OutputVariableType.Coordinates,
                    storeInternal=True,
                    writeToFile=False,
                )
            )
            for node in nodes[link]
        ]
        for link in LINKS
    }
    system.Assemble()
    began = time.process_time()
    system.SolveDynamic(settings(times, step))
    seconds = time.process_time() - began
    states = {
        link: [np.asarray(system.GetSensorStoredData(s))[:, 1:] for s in pair]
        for link, pair in sensors.items()
    }
    return measured(times, states, places, seconds)


def settings(times: Array, step: float) -> Any:
    """Exudyn's settings: outputs at our times; Newton to what rounding leaves of stiff axes."""
    chosen = exudyn.SimulationSettings()
    chosen.timeIntegration.numberOfSteps = round(times[-1] / step)
    chosen.timeIntegration.endTime = float(times[-1])
    chosen.timeIntegration.newton.useModifiedNewton = True
    chosen.timeIntegration.newton.relativeTolerance = 1e-6
    chosen.timeIntegration.generalizedAlpha.spectralRadius = 0.9
    chosen.timeIntegration.verboseMode = 0
    chosen.solution.file.write = False
    chosen.solution.sensors.writePeriod = float(times[1] - times[0])
    chosen.linearSolver.solverType = exudyn.LinearSolverType.EigenSparse
    return chosen


def measured(
    times: Array, states: dict[str, list[Array]], places: dict[str, tuple[Array, Array]], s: float
) -> Fall:
    """Joint angles from the previous tangent, and tips' deflection across the root's tangent.

    A node's coordinates are the changes of its position and of its slope, (4,).
    """
    tangents, deflections = {}, []
    for link in LINKS:
        root, tip = states[link]
        start, end = places[link]
        along = (end - start)[:2]
        slopes = [along + node[:, 2:] for node in (root, tip)]
        tangents[link] = [np.unwrap(np.arctan2(slope[:, 1], slope[:, 0])) for slope in slopes]
        reach = along + tip[:, :2] - root[:, :2]
        unit = slopes[0] / np.linalg.norm(slopes[0], axis=1)[:, None]
        deflections.append(unit[:, 0] * reach[:, 1] - unit[:, 1] * reach[:, 0])
    angles = [
        tangents['link_1'][0],
        tangents['link_2'][0] - tangents['link_1'][1],
        tangents['link_3'][0],
        tangents['link_4'][0] - tangents['link_3'][1],
    ]
    return Fall(times, np.column_stack(angles), np.column_stack(deflections), s, np.nan)


def our_fall(times: Array, shapes: int = SHAPES) -> Fall:
    """Free fall by the recursion and its compiled integrator."""
    robot = loaded('five_bar', 'FFFF', shapes, 'craig-bampton')
    book_fall(robot, 'five_bar', times[:2], **TOLERANCES)  # loads the compiled code
    began = time.process_time()
    run = book_fall(robot, 'five_bar', times, **TOLERANCES)
    seconds = time.process_time() - began
    tips = [robot.tip_deflection(link, run.q)[:, 1] for link in LINKS]
    angles = np.column_stack([run.coordinate(joint) for joint in JOINTS])
    return Fall(times, angles, np.column_stack(tips), seconds, run.energy_drift)


def differences(one: Fall, other: Fall) -> tuple[float, float]:
    """Largest gap of angles [rad], and of deflections over their peak, as long as both last."""
    count = min(len(one.t), len(other.t))
    angle = np.max(np.abs(one.angles[:count] - other.angles[:count]))
    peaks = np.max(np.abs(other.deflections[:count]), axis=0)
    deflection = np.max(np.abs(one.deflections[:count] - other.deflections[:count]) / peaks)
    return float(angle), float(deflection)


def compare(duration: float, repeats: int, step: float = STEP) -> Comparison:
    """Run both in turn."""
    times = np.linspace(0.0, duration, round(100 * duration) + 1)
    theirs, ours = [], []
    for _ in range(repeats):
        theirs.append(exudyn_fall(times, step=step))
        ours.append(our_fall(times))
    early = times[times <= EARLY + 1e-9]
    angle, deflection = differences(ours[0], exudyn_fall(early, step=FINE))
    slow, fast = min(run.seconds for run in theirs), min(run.seconds for run in ours)
    return Comparison(slow, fast, slow / fast, ours[0].drift, angle, deflection)


def main() -> None:
    """Print the comparison."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--duration', type=float, default=2.5, help='s of free fall')
    parser.add_argument('--repeats', type=int, default=3)
    parser.add_argument('--step', type=float, default=STEP, help="s, Exudyn's")
    args = parser.parse_args()
    print(json.dumps(vars(compare(args.duration, args.repeats, args.step)), indent=2))


if __name__ == '__main__':
    main()
