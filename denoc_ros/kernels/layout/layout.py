"""Layout of the flat arrays of a model.

Three arrays are a model: `topology` (rows, TOPOLOGY_COLUMNS), unsigned: row 0 the base, a row per
body, a row per frame; `constants`, all real constants; `work`, the caller's workspace. A body's
constants start at `topology[i, BODY_CONSTANTS]`, its workspace at `topology[i, WORK]`; the offsets
below count from there. Rotations are row-major and take body axes to the axes of what carries the
body.
"""

# columns of topology
PARENT = 0  # row of the body that carries this one, 0: the base
MOTION = 1  # FIXED, REVOLUTE, PRISMATIC or REVOLUTE_Z
COORDINATE = 2  # index of the first coordinate
JOINT = 3  # number of joint coordinates: 0 or 1
NY = 4  # numbers of modes
NZ = 5
NT = 6
MODES = 7  # NY + NZ + NT
POINTS = 8  # number of integration points of the beam
BODY_CONSTANTS = 9  # offset of the body's constants in constants
BEAM = 10  # offset of the beam's constants in constants
SECTION = 11  # offset of the attachment's section constants in constants, 0: rigid attachment
WORK = 12  # offset of the body's workspace in work
BEAM_WORK = 13  # offset of the beam's workspace
SECTION_WORK = 14  # offset of the section's workspace
INERTIA_WORK = 15  # offset of the inertia: (6 + MODES)^2, or a block where rigid
ELIMINATED = 16  # offset of what is eliminated: W (k columns), L (k k), y (k), k = JOINT + MODES
DERIVED = 17  # offset of the body's workspace of derivatives (see derivative_layout)
OWN = 18  # offset of that of its beam
BRANCH_END = 19  # index after the last coordinate of the body and all it carries
RUN = 20  # row of the body from which on each carries the next, down to this one
SIBLING = 21  # row of the body before this one on the same carrier, 0: none
SLOT = 22  # where right-hand sides pass through this body (see right_hand_sides)
COMPONENTS = 23  # number of component modes: MODES of a link that has them, else 0
BENT = 24  # how many of its points' numbers have a Gamma, in whole vectors of lanes
TOPOLOGY_COLUMNS = 25

FIXED = 0
REVOLUTE = 1
PRISMATIC = 2
REVOLUTE_Z = 3  # revolute about the z axis of the body frame, whose origin lies on it

# constants: the model
GRAVITY = 0  # (3) in the base frame
SLIP_RATE = 3  # of Coulomb friction [rad/s or m/s]
HEADER = 4

# constants: a body, from BODY_CONSTANTS
POSE_CONSTANT = 0  # (12) rotation and translation of the body on its carrier: the constant part,
POSE_SINE = 12  # (12) the part that goes with sin q (revolute) or q (prismatic),
POSE_VERSINE = 24  # (12) and the part that goes with 1 - cos q
AXIS = 36  # (6) motion subspace in the body frame, linear first
MASS = 42  # mass, first moment (3), inertia about the origin (6: xx xy xz yy yz zz)
FIRST_MOMENT = 43
ROTATIONAL_INERTIA = 46
BODY_CONSTANTS_SIZE = 52

# constants: a beam, from BEAM:
# polar (1) = int rho J, polar_j (NT), polar_jk (NT NT), then per point:
# weight, station, s_y (NY), s_z (NZ), H_y (NY NY), H_z (NZ NZ)

# constants: a link with component modes, from BEAM, POINTS in whole lanes:
# e (POINTS), r (3 POINTS), Phi (MODES 3 POINTS), Gamma (BENT) of each
# pair of modes (0, 0), (1, 0), (1, 1), (2, 0) ...

# constants: a section, from SECTION:
# station, s_y (NY), s_z (NZ), s_y' (NY), s_z' (NZ), s_t (NT), H_y (NY NY), H_z (NZ NZ)
# with component modes: r (3), Phi (3 MODES), Theta (3 MODES), Gamma (3 MODES MODES), mode by mode

# work: a body, from WORK
ROTATION = 0  # (9) body axes to carrier axes
ARM = 9  # (3) section (or carrier origin, where rigid) to body origin, carrier axes
VELOCITY = 12  # (3) of the body origin, body axes (only where energies ask for it)
ANGULAR_VELOCITY = 15  # (3) angular
ACCELERATION = 18  # (3) classical, of the body origin, with -g at the base
ANGULAR_ACCELERATION = 21  # (3) angular acceleration
FORCE = 24  # (3)
TORQUE = 27  # (3) about the body origin
FREE_ACCELERATION = 30  # (6) acceleration owed to the free coordinates, linear first
WORLD_ROTATION = 36  # (9) body axes to base axes
WORLD_POSITION = 45  # (3)
COMPOSITE = 48  # mass, moment (3), spin (6) of the body, or of it and all it carries
BODY_WORK = 58

# work: the base, row 0: VELOCITY, ANGULAR_VELOCITY, ACCELERATION (less gravity) and
# ANGULAR_ACCELERATION are its own motion, in its axes; where a body keeps its force stands
BASE_GRAVITY = FORCE  # (3) gravity in base axes

# work: after the base's, a block in passing (see block)
BLOCK = BODY_WORK
BLOCK_SIZE = 21

# work: a beam, from BEAM_WORK:
# modal force (MODES), then per point: position (3), H_y d_y (NY), H_z d_z (NZ)
# with component modes: modal force (MODES), p (3 POINTS), B (MODES 3 POINTS),
# acc (3 POINTS; B d'' + B' d' before), B d' (3 POINTS)

# work: a section, from SECTION_WORK
SECTION_POSITION = 0  # (3) position of the section in the carrier's body frame
SECTION_ROTATION = 3  # (9) rotation of the section
ROTATION_VECTOR = 12  # (3) rotation vector phi
COEFFICIENTS = 15  # (4) b, c of the left Jacobian and their rates per phi . phi'
COLUMNS = 19  # per mode of the carrier: linear column (3), angular column (3)
