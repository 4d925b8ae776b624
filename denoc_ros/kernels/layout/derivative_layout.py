"""Layout of the derivatives' intermediate results in the workspace.

All motions and wrenches are in base axes about the base's origin, so that they pass from body to
body unchanged. For the bodies that it moves, a coordinate has a column J (6) of their
twist, and the column's first and second time derivative.
"""

# topology, row 0, in a column that means nothing to the base
ROW_LENGTH = 18  # of a row over the coordinates
BEAM_SCRATCH = 14  # offset of what sums over a beam's points take, one beam at a time

# work: a body, from DERIVED; the base too
TWIST = 0  # (6) linear first
ACCELERATED = 6  # (6) its time derivative, with -g at the base
BODY_MASS = 12  # of the body, or of it and all it carries, as all down to WRENCH
BODY_FIRST_MOMENT = 13  # (3) first moment
BODY_ROTATIONAL_INERTIA = 16  # (6) rotational inertia: xx xy xz yy yz zz
MOMENTUM = 22  # (3) linear
TURNING = 25  # (9) torque by an added angular velocity: 2 int (v . p - v p^T) dm, and spin
WRENCH = 34  # (6) force and torque
COMPOSITE_SIZE = 28  # BODY_MASS .. WRENCH
SEEN = 40  # per mode of the carrier: J, J', J'' as seen from here (18)
SEEN_SIZE = 18

# work: a beam, from OWN: rows over the modes, in whole lanes
BY_ACCELERATION = 0  # (6) the wrench by d'' of this mode
BY_TURNING = 6  # (3) half the modal force by an added angular velocity
BY_POSITION = 9  # (6) the wrench by d
BY_RATE = 15  # (6) the wrench by d'
OWN_SIZE = 21
# then the modal forces by d, d' and d'' (a row for each force, in whole lanes)

# work: from the base's DERIVED, after TWIST and ACCELERATED
SCRATCH = 12  # (9)
COLUMNS = 21  # rows of so many numbers as row_length says
COLUMN = 0  # (6) J of each coordinate
COLUMN_RATE = 6  # (6) J'
COLUMN_BEND = 12  # (6) J''
WRENCH_Q = 18  # (6) the wrench that comes inward by q,
WRENCH_QD = 24  # (6) by q'
WRENCH_QDD = 30  # (6) and by q''
PASSING = 36  # (PASSING_ROWS per slot) right-hand sides on their way, 6 for each of three
PASSING_ROWS = 18
LANES = 4

# work: from BEAM_SCRATCH, per point of a beam (see beam_sums): weight and position (4), slip,
# u, velocity and acceleration (3 each, in whole lanes), then the modes' four rows
POINT_MODES = 20
# then sums: of weight and position (row: the other factor) with the first three of these,
BODY_SUMS = 0
BODY_SUMS_SIZE = 48
# and of the modes' rows with weight, position (4), velocity (3) and acceleration (3), with h and
# s of each mode; last those of H
COLUMN_SUMS = 10


def whole_lanes(n: int) -> int:
    """Return the length of a row of n numbers in whole lanes."""
    return (n + LANES - 1) // LANES * LANES


def row_length(n: int) -> int:
    """Return the length of a row over n coordinates: whole lanes, and as many again beyond."""
    return whole_lanes(n) + LANES


def scratch_size(ny: int, nz: int, points: int) -> int:
    """Size of the sums over a beam's points."""
    row = 4 * whole_lanes(ny + nz)
    sums = BODY_SUMS_SIZE + (COLUMN_SUMS + 2 * (ny + nz)) * row
    return points * (POINT_MODES + row) + sums + whole_lanes(ny * ny + nz * nz) + LANES


def component_scratch_size(points: int) -> int:
    """Return the size of what the points of component modes take: three vectors of each."""
    return 9 * points


def own_size(modes: int) -> int:
    """Return the size of a beam's workspace."""
    return whole_lanes(modes) * (OWN_SIZE + 3 * modes)


def base_size(n: int, slots: int) -> int:
    """Return the size of the base's workspace."""
    return COLUMNS + (PASSING + PASSING_ROWS * slots) * row_length(n)
