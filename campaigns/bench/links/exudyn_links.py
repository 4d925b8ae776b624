"""Arms of meshed links and of tapered beams beside Exudyn: the place of the tip over two seconds.

    python -m campaigns exudyn-links

`meshed`: two links of one mesh, at joints that turn about different axes. Exudyn's floating frame
of reference (`ObjectFFRFreducedOrder`) has the same stiffness, mass and modes. The arm starts with
rates of the joints and without gravity: Exudyn's gravity (`LoadMassProportional`) acts on the
undeformed body. The difference is of second order in the deflections, for its markers turn by
linear angles.

`tapered`: a stepped and tapered arm of two links that swings in a plane, beside 64
geometrically exact cable elements a link.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import exudyn
import numpy as np
from exudyn.FEM import FEMinterface, ObjectFFRFreducedOrderInterface
from exudyn.itemInterface import (
    GenericJoint,
    LoadMassProportional,
    MarkerBodyMass,
    MarkerBodyPosition,
    MarkerBodyRigid,
    MarkerNodePosition,
    MarkerSuperElementRigid,
    NodePoint2DSlope1,
    ObjectANCFCable2D,
    ObjectGround,
    ObjectJointRevolute2D,
    SensorMarker,
    SensorNode,
)
from scipy.sparse import csr_matrix
from skfem import MeshTet

import denoc_ros as dn
from denoc_ros.model.beams import link_file
from denoc_ros.reduction.body import Patch
from denoc_ros.reduction.craig_bampton import link_modes, reduce_body
from denoc_ros.reduction.elements import Elasticity, Solid
from denoc_ros.reduction.link import Wishes, reduce_link
from denoc_ros.types import Array

DURATION = 2.0  # s
OUTPUTS = 21
LENGTH, WIDTH, HEIGHT = 0.5, 0.05, 0.04  # m, of a meshed link
POISSON, DENSITY = 0.3, 2700.0
DAMPING = 2e-4  # s, of the stiffness
MODES = 6
RATES = 1.0, 2.0  # rad/s
RTOL, ATOL = 1e-10, 1e-12

# x [m], EI [N m2], mass per length [kg/m]: tapers, then steps, then tapers
STATIONS = ((0.0, 900.0, 3.0), (0.4, 500.0, 2.4), (0.4, 350.0, 1.6), (1.0, 150.0, 1.0))
REACH = 2.0  # m, of the tapered arm
STIFF = 1e7  # N, EA along the axis of Exudyn's elements: ours do not stretch


@dataclass(frozen=True)
class Difference:
    """Largest distance of the tips and largest deflection of a link, over the arm's reach."""

    tip: float
    deflection: float


def block(young: float) -> Solid:
    """Mesh of one link, of tetrahedra with ten nodes."""
    mesh = MeshTet.init_tensor(
        np.linspace(0.0, LENGTH, 7),
        np.linspace(-WIDTH / 2, WIDTH / 2, 2),
        np.linspace(-HEIGHT / 2, HEIGHT / 2, 2),
    )
    elasticity = Elasticity.of(young, young / (2.0 * (1.0 + POISSON)), DENSITY)
    return Solid('block', mesh.p.T, mesh.t.T, elasticity)


def ends(solid: Solid) -> list[Patch]:
    """Return the rigid faces at both ends."""
    return [
        Patch(name, np.array([x, 0.0, 0.0]), np.eye(3), np.flatnonzero(on_face), 1.0)
        for name, x in (('', 0.0), ('tip', LENGTH))
        for on_face in [np.abs(solid.nodes[:, 0] - x) < 1e-9]
    ]


def meshed(
    young: float,
    rates: tuple[float, float] = RATES,
    duration: float = DURATION,
    step: float = 1e-4,
) -> Difference:
    """Compare the arm of meshed links with Exudyn's; its results are extrapolated in the step.

    Parameters
    ----------
    young : float
        Young's modulus [Pa].
    rates : (float, float)
        Of the joints at the start [rad/s].
    duration, step : float
        [s]; Exudyn also runs at twice the step.
    """
    times = np.linspace(0.0, duration, OUTPUTS)
    solid = block(young)
    with tempfile.TemporaryDirectory() as folder:
        robot = meshed_arm(solid, Path(folder))
    start = np.zeros(robot.n)
    start[[robot.coordinate_names.index(name) for name in ('j1', 'j2')]] = rates
    run = dn.simulate(robot, np.zeros(robot.n), start, times, rtol=RTOL, atol=ATOL)
    ours = np.array([robot.frame_pose('tip', q)[:3, 3] for q in run.q])
    coarse, fine = (exudyn_meshed(solid, times, rates, h) for h in (2.0 * step, step))
    return difference(robot, run.q, ours, fine + (fine - coarse) / 3.0, ('a', 'b'), 2.0 * LENGTH)


def difference(
    robot: dn.Robot, q: Array, ours: Array, theirs: Array, links: tuple[str, str], reach: float
) -> Difference:
    """Return both measures over the reach [m]; tips are (k, 3)."""
    deflections = [np.linalg.norm(robot.tip_deflection(link, q), axis=1) for link in links]
    return Difference(
        float(np.max(np.linalg.norm(ours - theirs, axis=1))) / reach,
        float(np.max(deflections)) / reach,
    )


def meshed_arm(solid: Solid, folder: Path) -> dn.Robot:
    """Reduce the mesh, write the link's file and the URDF of the arm; return the arm."""
    wishes = Wishes(modes=MODES, quadratic='none')
    link = reduce_link(solid.body(), solid, ends(solid), wishes, 'block').link
    damped = replace(link, damping_ratio=None, damping=DAMPING * link.stiffness)
    link_file.write(folder / 'link.npz', damped)
    (folder / 'arm.urdf').write_text(
        f"""<robot name="arm"><link name="base"/><link name="a"/><link name="b"/><link name="tip"/>
        <joint name="j1" type="continuous"><parent link="base"/><child link="a"/>
          <axis xyz="0 0 1"/></joint>
        <joint name="j2" type="continuous"><parent link="a"/><child link="b"/>
          <origin xyz="{LENGTH} 0 0"/><axis xyz="0 1 0"/></joint>
        <joint name="j3" type="fixed"><parent link="b"/><child link="tip"/>
          <origin xyz="{LENGTH} 0 0"/></joint>
        <flexibility><flexible link="a" file="link.npz" inertial="file"/>
          <flexible link="b" file="link.npz" inertial="file"/></flexibility></robot>"""
    )
    return dn.load_robot(folder / 'arm.urdf', gravity=[0.0, 0.0, 0.0])


def exudyn_meshed(solid: Solid, times: Array, rates: tuple[float, float], step: float) -> Array:
    """Return the places of the tip (k, 3) [m] of Exudyn's bodies with the same modes."""
    system = exudyn.SystemContainer().AddSystem()
    interface = ObjectFFRFreducedOrderInterface(finite_elements(solid))
    faces = [[int(node) for node in patch.nodes] for patch in ends(solid)]
    bodies = [
        interface.AddObjectFFRFreducedOrder(
            system,
            positionRef=[x, 0.0, 0.0],
            initialVelocity=[0.0, rates[0] * x, 0.0],
            initialAngularVelocity=[0.0, rates[1] if x else 0.0, rates[0]],
            stiffnessProportionalDamping=DAMPING,
        )['oFFRFreducedOrder']
        for x in (0.0, LENGTH)
    ]

    def on_face(body: int, end: int) -> Any:
        nodes = faces[end]
        weights = [1.0 / len(nodes)] * len(nodes)
        return system.AddMarker(
            MarkerSuperElementRigid(
                bodyNumber=bodies[body], meshNodeNumbers=nodes, weightingFactors=weights
            )
        )

    ground = system.AddMarker(MarkerBodyRigid(bodyNumber=system.AddObject(ObjectGround())))
    about_z, turned = [1, 1, 1, 1, 1, 0], np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    system.AddObject(GenericJoint(markerNumbers=[ground, on_face(0, 0)], constrainedAxes=about_z))
    system.AddObject(
        GenericJoint(
            markerNumbers=[on_face(0, 1), on_face(1, 0)],
            constrainedAxes=about_z,
            rotationMarker0=turned,
            rotationMarker1=turned,
        )
    )
    tip = system.AddSensor(
        SensorMarker(
            markerNumber=on_face(1, 1),
            outputVariableType=exudyn.OutputVariableType.Position,
            storeInternal=True,
        )
    )
    return integrated(system, times, step, 1.0, 1e-11)(tip)


def finite_elements(solid: Solid) -> FEMinterface:
    """Give Exudyn the matrices and the modes of our reduction, node by node."""
    body = solid.body()
    craig_bampton = reduce_body(body, ends(solid), MODES, lambda _: None)
    found = link_modes(craig_bampton, MODES, {})
    modes = body.displacement(craig_bampton.expand(found.coordinates))
    count = len(solid.nodes)
    by_node = np.arange(3 * count).reshape(3, count).T.ravel()
    interface = FEMinterface()
    interface.nodes = {'Position': np.array(solid.nodes)}
    interface.massMatrix = csr_matrix(body.mass)[by_node][:, by_node]
    interface.stiffnessMatrix = csr_matrix(body.stiffness)[by_node][:, by_node]
    interface.modeBasis = {'matrix': modes.reshape(3 * count, MODES), 'type': 'NormalModes'}
    interface.eigenValues = found.stiffness
    interface.GetSurfaceTriangles = list
    interface.postProcessingModes = {}
    return interface


def tapered(duration: float = DURATION, elements: int = 64, step: float = 2.5e-4) -> Difference:
    """Compare the tapered arm, which falls from the horizontal, with Exudyn's elements.

    Parameters
    ----------
    duration, step : float
        [s].
    elements : int
        Of a link; Exudyn also runs with half as many, and its results are extrapolated.
    """
    times = np.linspace(0.0, duration, OUTPUTS)
    robot = tapered_arm()
    run = dn.simulate(robot, np.zeros(robot.n), np.zeros(robot.n), times, rtol=RTOL, atol=ATOL)
    ours = np.array([robot.frame_pose('tip', q)[:3, 3] for q in run.q])
    coarse, fine = (exudyn_tapered(times, n, step) for n in (elements // 2, elements))
    return difference(robot, run.q, ours, fine + (fine - coarse) / 3.0, ('a', 'b'), REACH)


def tapered_arm() -> dn.Robot:
    """Return our arm: stations as they are, four of its own modes a link."""
    stations = ''.join(
        f'<at x="{x}" ei_y="{ei}" ei_z="{ei}" gj="{ei}" mass_per_length="{mass}"/>'
        for x, ei, mass in STATIONS
    )
    beams = ''.join(
        f'<beam link="{link}" length="1.0" shape="craig-bampton">{stations}'
        '<bending direction="y" modes="4"/></beam>'
        for link in ('a', 'b')
    )
    mass, first, second = moments()
    centre = first / mass
    about = second - mass * centre**2
    links = ''.join(
        f'<link name="{name}"><inertial><origin xyz="{centre!r} 0 0"/><mass value="{mass!r}"/>'
        f'<inertia ixx="0" iyy="{about!r}" izz="{about!r}" ixy="0" ixz="0" iyz="0"/>'
        '</inertial></link>'
        for name in ('a', 'b')
    )
    return dn.load_robot(
        f"""<robot name="arm"><link name="base"/>{links}<link name="tip"/>
        <joint name="j1" type="continuous"><parent link="base"/><child link="a"/>
          <axis xyz="0 0 1"/></joint>
        <joint name="j2" type="continuous"><parent link="a"/><child link="b"/>
          <origin xyz="1 0 0"/><axis xyz="0 0 1"/></joint>
        <joint name="j3" type="fixed"><parent link="b"/><child link="tip"/>
          <origin xyz="1 0 0"/></joint><flexibility>{beams}</flexibility></robot>""",
        gravity=[0.0, -9.81, 0.0],
    )


def moments() -> tuple[float, float, float]:
    """Return mass [kg], first and second moment about the root of a tapered link."""
    found = np.zeros(3)
    points, weights = np.polynomial.legendre.leggauss(3)
    for (x0, _, m0), (x1, _, m1) in pairwise(STATIONS):
        x = x0 + 0.5 * (x1 - x0) * (points + 1.0)
        mass = 0.5 * (x1 - x0) * weights * np.interp(points, (-1.0, 1.0), (m0, m1))
        found += [np.sum(mass), np.sum(mass * x), np.sum(mass * x**2)]
    return float(found[0]), float(found[1]), float(found[2])


def exudyn_tapered(times: Array, elements: int, step: float) -> Array:
    """Return the places of the tip (k, 3) [m] of Exudyn's beam elements."""
    system = exudyn.SystemContainer().AddSystem()
    on_ground = MarkerBodyPosition(bodyNumber=system.AddObject(ObjectGround()))
    pinned, last = system.AddMarker(on_ground), 0
    step_at = STATIONS[1][0]
    first = round(step_at * elements)
    places = np.append(
        np.linspace(0.0, step_at, first + 1)[:-1],
        np.linspace(step_at, 1.0, elements - first + 1),
    )
    for root in (0.0, 1.0):
        nodes = [
            system.AddNode(NodePoint2DSlope1(referenceCoordinates=[root + x, 0.0, 1.0, 0.0]))
            for x in places
        ]
        for pair, (x0, x1) in zip(pairwise(nodes), pairwise(places), strict=True):
            stiffness, mass = section(0.5 * (x0 + x1))
            element = system.AddObject(
                ObjectANCFCable2D(
                    physicsLength=x1 - x0,
                    physicsMassPerLength=mass,
                    physicsBendingStiffness=stiffness,
                    physicsAxialStiffness=STIFF,
                    nodeNumbers=list(pair),
                    useReducedOrderIntegration=1,
                )
            )
            weigh(system, element)
        root_marker = system.AddMarker(MarkerNodePosition(nodeNumber=nodes[0]))
        system.AddObject(ObjectJointRevolute2D(markerNumbers=[pinned, root_marker]))
        last = nodes[-1]
        pinned = system.AddMarker(MarkerNodePosition(nodeNumber=last))
    tip = system.AddSensor(
        SensorNode(
            nodeNumber=last,
            outputVariableType=exudyn.OutputVariableType.Position,
            storeInternal=True,
        )
    )
    return integrated(system, times, step, 0.9, 1e-6)(tip)


def section(x: float) -> tuple[float, float]:
    """Return EI [N m2] and mass per length [kg/m] at a place that is no step."""
    after = next(k for k, station in enumerate(STATIONS) if station[0] > x)
    (x0, *before), (x1, *behind) = STATIONS[after - 1], STATIONS[after]
    share = (x - x0) / (x1 - x0)
    stiffness, mass = ((1.0 - share) * a + share * b for a, b in zip(before, behind, strict=True))
    return stiffness, mass


def weigh(system: Any, element: int) -> None:
    """Let gravity act on an element."""
    marker = system.AddMarker(MarkerBodyMass(bodyNumber=element))
    system.AddLoad(LoadMassProportional(markerNumber=marker, loadVector=[0.0, -9.81, 0.0]))


def integrated(
    system: Any, times: Array, step: float, radius: float, newton: float
) -> Callable[[int], Array]:
    """Solve by generalized alpha of a spectral radius; return the reader of a sensor's rows."""
    system.Assemble()
    chosen = exudyn.SimulationSettings()
    chosen.timeIntegration.numberOfSteps = round(times[-1] / step)
    chosen.timeIntegration.endTime = float(times[-1])
    chosen.timeIntegration.newton.useModifiedNewton = True
    chosen.timeIntegration.newton.relativeTolerance = newton
    chosen.timeIntegration.newton.absoluteTolerance = 0.1 * newton
    chosen.timeIntegration.generalizedAlpha.spectralRadius = radius
    chosen.timeIntegration.verboseMode = 0
    chosen.solution.file.write = False
    chosen.solution.sensors.writePeriod = float(times[1] - times[0])
    chosen.linearSolver.solverType = exudyn.LinearSolverType.EigenSparse
    system.SolveDynamic(chosen)

    def at_times(sensor: int) -> Array:
        rows = np.asarray(system.GetSensorStoredData(sensor))
        nearest = [int(np.argmin(np.abs(rows[:, 0] - time))) for time in times]
        return np.ascontiguousarray(rows[nearest, 1:4])

    return at_times


def show(what: str, found: Difference) -> None:
    """Print a row."""
    print(f'{what}: tip {found.tip:.2g} of the reach, deflections {found.deflection:.2g}')


def main() -> int:
    """Print both comparisons."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.parse_args()
    rows: list[tuple[str, Difference]] = [
        (
            f'meshed links, E {young:g} Pa, {rates[0]:g} and {rates[1]:g} rad/s',
            meshed(young, rates),
        )
        for young, rates in ((2e9, RATES), (2e10, RATES), (2e9, (2.0, 4.0)))
    ]
    rows.append(('stepped, tapered arm that falls', tapered()))
    for what, found in rows:
        print(f'{what}: tip {found.tip:.2g} of the reach, deflections {found.deflection:.2g}')
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
