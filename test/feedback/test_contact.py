"""The tip strikes a soft wall that neither plan nor feedback knows of, and leaves it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from feedback_runs import PERIOD, Loop, Planned, canadarm, closed, described, tip_exact

from denoc_ros.types import Array

STIFFNESS, DAMPING = 2000.0, 200.0  # N/m, N s/m
DEPTH = 0.01  # m: so far the planned path goes beyond the wall's face


@dataclass
class Wall:
    """A wall that the tip's path bulges into, and the forces that it gave."""

    normal: Array  # (3,) out of the free side
    face: float  # m along the normal

    def __post_init__(self) -> None:
        self.forces = list[float]()

    def __call__(self, place: Array, velocity: Array) -> Array:
        deep = float(place @ self.normal) - self.face
        push = STIFFNESS * deep + DAMPING * float(velocity @ self.normal) if deep > 0.0 else 0.0
        self.forces.append(max(0.0, push))
        return np.asarray(-self.forces[-1] * self.normal)


def wall_beside(planned: Planned) -> Wall:
    """Return a wall along the chord of the tip's path, `DEPTH` inside its bulge."""
    path = planned.robot.frame_pose('tool', planned.q)[:, :3, 3]
    chord = path[-1] - path[0]
    normal = np.array([-chord[1], chord[0], 0.0]) / np.linalg.norm(chord)
    if np.abs((path - path[0]) @ normal).max() > ((path - path[0]) @ normal).max():
        normal = -normal
    return Wall(normal, float((path @ normal).max()) - DEPTH)


def test_a_blow_of_a_soft_wall_is_bounded_noticed_and_forgotten() -> None:
    text = described()
    planned, truth = tip_exact(4.0, 0.3, text), canadarm(source=described(modes=4))
    alone = Loop(planned, truth, None, contact=wall_beside(planned))
    struck = alone.run()
    loop, free = closed(planned, truth), closed(planned, truth)
    wall = loop.contact = wall_beside(planned)
    held = loop.run()
    first = int(np.flatnonzero(np.array(wall.forces)[::2])[0])
    answered = first + 100
    untouched = free.run(answered * PERIOD)
    assert max(wall.forces) > 10.0  # N, at the end of 13 m
    # bounded: within limits, and nothing jumps
    assert np.isfinite(held.torque).all()
    assert np.abs(held.torque).max() <= planned.limits[0]
    assert np.abs(np.diff(held.torque, axis=0)).max() < 0.02 * planned.limits[0]
    # noticed: measured and predicted disagree, and the feedback answers within 0.1 s
    change = np.abs(held.torque[:answered] - untouched.torque).max(axis=1)
    assert change[:first].max() == 0.0
    assert change[first:].max() > 20.0  # N m
    # the tip is back when the plan's has rested for four seconds; without feedback it swings on
    back = -round(1.0 / PERIOD)
    assert held.error[back:].max() < 2e-3
    assert struck.error[back:].max() > 5.0 * held.error[back:].max()
    assert held.share[-1] == 1.0
