"""Where the derivatives of constrained dynamics stand in work: after the constraints' workspace.

R rows are all rows, those of free axes included, r of them have multipliers; m = n + r.
"""

from typing import NamedTuple

# which verb
FORWARD = 0
INVERSE = 1
HYBRID = 2

# a frame's columns, per coordinate: J (linear, angular), J', J''; linear parts of all come first
FRAME_COLUMN = 18

# a loop: the motion of its child's frame as the parent's frame sees it, in the parent's axes
RELATIVE_ROTATION = 0  # (9)
RELATIVE_POSITION = 9  # (3) from the parent's to the child's origin
ANGULAR_VELOCITY = 12  # (3)
ANGULAR_ACCELERATION = 15  # (3)
LOOP_COLUMNS = 18
# then per coordinate: the relative motion's column (linear, angular), its two rates, and
LOOP_COLUMN = 21
PARENT_TURN = 18  # (3) the angular column of the parent's frame

# vectors over m, the greatest of the sizes that they have
FLAGS = 0  # 1 for coordinates whose accelerations are given
GIVEN = 1  # these accelerations
FORCE = 2  # generalized forces, wrenches included
ACCELERATION = 3  # q''
NEED = 4  # what I q'' + h lacks
WEIGHTS = 5  # (R) multipliers, then forces along free axes
TORQUES = 6  # v of the saddle: torques, and multipliers of the other coordinates' equations
TURNING = 7  # v with J v = multipliers
STILL = 8  # zeros
ROW = 9  # while one row of a matrix is worked on
VECTORS = 10


class Places(NamedTuple):
    """Offsets in work."""

    frames: int  # columns of two frames
    loops: int  # what stands above, loop after loop
    rates: int  # J, J', J'' of all rows (R, n) along the motion
    applied: int  # the same along another motion
    by_q: int  # derivatives of the forces that the motion asks for (n, n)
    by_rate: int
    inertia: int
    motion: int  # changes of q'' by q, q' and by what drives (3, n, n)
    pushes: int  # changes of the multipliers by the same (3, r, n), then I^-1 J^T (n, r)
    torques: int  # changes of the torques (3, n, n)
    saddle: int  # (m, m) factored, then scales of the reflections (2, m)
    order: int  # (m) of its columns
    sides: int  # right-hand sides (m, n)
    solution: int  # (m, n)
    open: int  # (m, n) what the saddle leaves open
    jacobian: int  # (6, n)
    wrench: int  # (6), then how its torque turns (9)
    vectors: int
    end: int


def lay_out(start: int, rows: int, axis_rows: int, constraints: int, n: int) -> Places:
    """Return the places for n coordinates; they begin at `start`."""
    total, m = rows + axis_rows, max(n + rows, rows + axis_rows)
    loops = start + 2 * FRAME_COLUMN * n
    rates = loops + constraints * (LOOP_COLUMNS + LOOP_COLUMN * n)
    applied = rates + 3 * total * n
    by_q = applied + 3 * total * n
    by_rate, inertia, motion = by_q + n * n, by_q + 2 * n * n, by_q + 3 * n * n
    pushes = motion + 3 * n * n
    torques = pushes + 4 * rows * n
    saddle = torques + 3 * n * n
    order = saddle + m * m + 2 * m
    sides = order + m
    solution, empty = sides + m * n, sides + 2 * m * n
    jacobian = empty + m * n
    wrench = jacobian + 6 * n
    vectors = wrench + 15
    return Places(
        start, loops, rates, applied, by_q, by_rate, inertia, motion, pushes, torques, saddle,
        order, sides, solution, empty, jacobian, wrench, vectors, vectors + VECTORS * m,
    )  # fmt: skip
