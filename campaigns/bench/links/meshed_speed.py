"""Time of an arm of meshed links beside one of beams with as many modes.

    python -m campaigns meshed

Two links, six modes each: the mesh's with all terms of second order, the beams' three in each
plane. Calls take turns; a ratio is the median of those of the blocks.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from book.benchmarks.timing import FULL, Effort, Subject, compare, ratio
from skfem import MeshTet

import denoc_ros as dn
from denoc_ros.model.beams import link_file
from denoc_ros.reduction.body import Patch
from denoc_ros.reduction.elements import Elasticity, Solid
from denoc_ros.reduction.link import Wishes, reduce_link

LENGTH, WIDTH, HEIGHT = 0.5, 0.05, 0.04  # m
MODES = 6
STATES = 8
VERBS = {'inverse_dynamics': 3, 'inverse_dynamics_derivatives': 3, 'inertia_matrix': 1}
BEAM = (
    '<beam link="{}" length="0.5" mass_per_length="5.2">'
    '<bending direction="y" ei="400" modes="3"/><bending direction="z" ei="300" modes="3"/></beam>'
)
RIGID = (
    '<link name="{}"><inertial><origin xyz="0.25 0 0"/><mass value="2.7"/>'
    '<inertia ixx="0.01" iyy="0.06" izz="0.06" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)


def arm(links: str, flexible: str) -> str:
    """Return the description of the arm from its links a and b."""
    return f"""<robot name="arm"><link name="base"/>{links}<link name="tip"/>
    <joint name="j1" type="continuous"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
    </joint>
    <joint name="j2" type="continuous"><parent link="a"/><child link="b"/>
      <origin xyz="{LENGTH} 0 0"/><axis xyz="0 1 0"/></joint>
    <joint name="j3" type="fixed"><parent link="b"/><child link="tip"/>
      <origin xyz="{LENGTH} 0 0"/></joint><flexibility>{flexible}</flexibility></robot>"""


def meshed(folder: Path) -> list[dn.Robot]:
    """Return the arm of meshed links, and without its terms of second order."""
    axes = ((0.0, LENGTH, 13), (-WIDTH / 2, WIDTH / 2, 3), (-HEIGHT / 2, HEIGHT / 2, 3))
    mesh = MeshTet.init_tensor(*(np.linspace(*axis) for axis in axes))
    solid = Solid('block', mesh.p.T, mesh.t.T, Elasticity.of(2e9, 0.77e9, 2700.0))
    ends = [
        Patch(name, np.array([x, 0.0, 0.0]), np.eye(3), np.flatnonzero(on_face), 1.0)
        for name, x in (('', 0.0), ('tip', LENGTH))
        for on_face in [np.abs(solid.nodes[:, 0] - x) < 1e-9]
    ]
    link = reduce_link(solid.body(), solid, ends, Wishes(modes=MODES), 'block').link
    link_file.write(folder / 'link.npz', link)
    blocks = (f'<flexible link="{name}" file="link.npz" inertial="file"/>' for name in 'ab')
    path = folder / 'arm.urdf'
    path.write_text(arm('<link name="a"/><link name="b"/>', ''.join(blocks)))
    return [dn.load_robot(path, geometric_stiffness=bends) for bends in (True, False)]


def ratios(effort: Effort = FULL) -> dict[str, tuple[float, float]]:
    """Return per verb the times over the beams', with and without terms of second order."""
    with tempfile.TemporaryDirectory() as folder:
        robots = meshed(Path(folder))
    robots.append(dn.load_robot(arm(*(''.join(map(t.format, 'ab')) for t in (RIGID, BEAM)))))
    states = 0.1 * np.random.default_rng(1).normal(size=(STATES, 3, robots[0].n))
    found = {}
    for verb, count in VERBS.items():
        subjects = [
            Subject(getattr(robot, verb), [tuple(state[:count]) for state in states])
            for robot in robots
        ]
        *ours, beams = compare(subjects, effort)
        first, second = (ratio(times, beams).value for times in ours)
        found[verb] = first, second
    return found


def main() -> int:
    """Print a row per verb."""
    argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0]).parse_args()
    for verb, (full, linear) in ratios().items():
        print(f'{verb}: {full:.2f} of the beams, {linear:.2f} without terms of second order')
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
