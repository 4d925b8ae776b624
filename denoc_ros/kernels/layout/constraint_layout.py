"""Layout of loops and mimic joints in the flat arrays: both constrain coordinates, row by row.

The last rows of `topology` are the constraints, loops in file order and then mimic joints. Every
constraint has rows of its own among the multipliers; loops with damping or friction have one more
row each, of their free axis, after all of these.
"""

# topology, row 0, in columns that mean nothing to the base
CONSTRAINTS = 2  # number of constraints
ROWS = 3  # number of multipliers
FIRST_CONSTRAINT = 5  # the row of the first constraint
AXIS_ROWS = 4  # number of free axes with damping or friction
CONSTRAINTS_WORK = 13  # offset of the constraints' workspace

# columns of topology, a constraint's row
KIND = 0  # of its angular rows
SUPPORT_PATHS = 1  # the next three: where the ways of a wrench to the base begin
CHILD = 1  # row of the child's loop frame, or of the body of the mimic joint
OTHER = 2  # row of the parent's loop frame, or of the body of the leader
COMMON_ANCESTOR = 3  # row of the body, or the base, that carries both
ROW = 4  # its first row
LINEAR = 5  # number of linear rows
ANGULAR = 6  # number of angular rows
REFERENCES = 7  # number of directions that must agree on both sides
CONSTANTS = 8  # offset of its constants in constants
AXIS_ROW = 9  # row of its free axis, 0: none

POINT = 0  # no angular rows
ALIGNED = 1  # one axis is the same on both sides
ORIENTED = 2  # all axes are
UNIVERSAL = 3  # axis and axis2 are perpendicular
MIMIC = 4

# constants: a loop, from CONSTANTS; then directions (3) of its linear and angular rows and of its
# references
FREE_AXIS = 0  # (3) parent's loop frame
SECOND_AXIS = 3  # (3) child's loop frame
DAMPING = 6
FRICTION = 7
SLIDES = 8  # 1: the free axis is a translation
DIRECTIONS = 9

# constants: a mimic joint
MULTIPLIER = 0
OFFSET = 1

# work: the constraints, from CONSTRAINTS_WORK: scratch, then what grows with the number of rows
SIDES = 0  # (2 of 12) rotation and position of both frames on the meeting body
RELATIVE = 24  # (9) rotation: child seen from parent
RELATIVE_POSITION = 33  # (3) from the parent's to the child's origin, parent's axes
LOADS = 36  # (2 of 7 of 6) wrenches on their way inward
RANK = 120  # of the rows, as the last solve found it
WORST = 121  # the row that contradicts the others most, and by how much [m/s^2, rad/s^2]
RESIDUAL = 122
VECTORS = 123  # vectors over all rows, those of free axes included
ERROR = 0
RATE = 1
BIAS = 2
MULTIPLIERS = 3
WANTED = 4  # what the rows must do, then what they did
SCALE = 5
ORDER = 6
LEFT = 7
PART = 8
AXIS_FORCE = 9  # forces along free axes beside their damping and friction
SLOPE = 10  # damping of free axes, with the slope of their friction
CONSTRAINT_VECTORS = 11
# then the wrenches (6 per row) in the parent's loop frame, at the child's origin; y (n) of the
# loads and D^-1 (n); columns y (rows, n) of the rows; their products (rows, rows) and two factors


def work_size(rows: int, axis_rows: int, n: int) -> int:
    """Return the size of the constraints' workspace for n coordinates."""
    total = rows + axis_rows
    return VECTORS + total * (CONSTRAINT_VECTORS + 6 + n + 3 * total) + 2 * n
