"""The immutable tree as the flat arrays of the kernels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from denoc_ros.kernels.layout import constraint_layout, derivative_layout, layout
from denoc_ros.kernels.layout.constrained_derivative_layout import lay_out
from denoc_ros.model.beams.beam_arrays import (
    ComponentPoints,
    beam_points,
    component_points,
    polar_constants,
    section_constants,
    section_of_modes,
)
from denoc_ros.model.coordinates import (
    SLIDING_MODES,
    SLIDING_SECTION,
    TURNING_AXES,
    TURNING_MODES,
    TURNING_SECTION,
    base_indices,
    diagonals,
    massless_body,
    massless_modes,
    names,
)
from denoc_ros.model.inertia import beam_inertia
from denoc_ros.model.joint_friction import SLIP_RATE
from denoc_ros.model.link_side import has_springs, link_map, without_springs
from denoc_ros.model.loop_constraints import constraints_to_arrays
from denoc_ros.model.reading.poses import pose_of
from denoc_ros.model.tree import Attachment, Body, JointKind, RigidInertia, Tree
from denoc_ros.types import Array


def cross_matrix(v: Array) -> Array:
    """Return v x as a (3, 3) matrix."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def pose_rows(rotation: Array, translation: Array) -> Array:
    """Return a rotation (3, 3), row by row, and a translation (3,) as twelve numbers."""
    return np.concatenate([rotation.ravel(), translation])


def joint_axes(body: Body, flexible: bool) -> Array:
    """Return the (3, 3) turn from the body frame to axes with z along the joint of a rigid body.

    A body whose joint turns about z costs the kernels least; beams need their own axes.
    """
    joint = body.joint
    if joint is None or joint.kind is not JointKind.REVOLUTE or flexible:
        return np.eye(3)
    z = body.frame[:3, :3].T @ joint.axis
    if abs(z[0]) < abs(z[2]):
        x = np.array([z[2], 0.0, -z[0]])
    else:
        x = np.array([-z[1], z[0], 0.0])
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def motion_kind(body: Body, frame: Array) -> int:
    """Return the kind of motion of a body with its frame (4, 4) on the link frame."""
    kind = JointKind.FIXED if body.joint is None else body.joint.kind
    if kind is JointKind.REVOLUTE:
        assert body.joint is not None
        about_z = np.allclose(frame[:3, :3].T @ body.joint.axis, [0.0, 0.0, 1.0], 0.0, 1e-15)
        through = np.allclose(np.cross(body.joint.axis, frame[:3, 3]), 0.0, 0.0, 1e-15)
        return layout.REVOLUTE_Z if about_z and through else layout.REVOLUTE
    return {JointKind.FIXED: layout.FIXED, JointKind.PRISMATIC: layout.PRISMATIC}[kind]


def pose_constants(body: Body, placement: Array, frame: Array) -> list[Array]:
    """Return the still, first and second part of the body's pose, and its motion subspace."""
    still = placement @ frame
    rows = [pose_rows(still[:3, :3], still[:3, 3]), np.zeros(12), np.zeros(12), np.zeros(6)]
    joint = body.joint
    if joint is None or joint.kind is JointKind.FIXED:
        return rows
    rotation, offset = frame[:3, :3], frame[:3, 3]
    outer = placement[:3, :3]
    if joint.kind is JointKind.PRISMATIC:
        rows[1] = pose_rows(np.zeros((3, 3)), outer @ joint.axis)
        rows[3][:3] = rotation.T @ joint.axis
        return rows
    k = cross_matrix(joint.axis)
    rows[1] = pose_rows(outer @ k @ rotation, outer @ k @ offset)
    rows[2] = pose_rows(outer @ k @ k @ rotation, outer @ k @ k @ offset)
    rows[3] = np.concatenate([rotation.T @ (k @ offset), rotation.T @ joint.axis])
    return rows


@dataclass(frozen=True)
class ModelArrays:
    """A robot as flat arrays, laid out as in :mod:`denoc_ros.kernels.layout.layout`."""

    # (1 + bodies + frames + constraints, TOPOLOGY_COLUMNS), row 0 the base
    topology: NDArray[np.uint32]
    constants: Array
    diagonals: Array  # (6, n) of coordinates: stiffness, damping, friction, armature, ...
    # rows of bodies: those of the tree, motor sides of elastic joints, massless ones before a
    # floating base
    bodies: int
    body_rows: tuple[int, ...]  # of each body of the tree, its row
    work_size: int
    frame_rows: dict[str, int]
    mount_rows: dict[str, int]  # of the inertial sensors, by their frames' names
    axes: tuple[Array, ...]  # per row of a body, (3, 3): its axes seen from the body frame
    coordinate_names: tuple[str, ...]
    joint_names: tuple[str, ...]
    joint_indices: NDArray[np.int64]
    base_indices: NDArray[np.int64]  # (6,) of a floating base, else (0,)
    constraint_names: tuple[str, ...]  # per multiplier, of its loop or mimic joint
    link_side: ModelArrays | None = None  # the robot without springs; None: it has none
    link_map: NDArray[np.uint32] | None = None  # (2, m), see model.link_side

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return int(self.diagonals.shape[1])

    def with_diagonals(self, diagonals: Array) -> ModelArrays:
        """Return the same bodies with other terms along the coordinates."""
        chain = self.link_side
        if chain is not None and self.link_map is not None:
            own = np.where(self.link_map[1], chain.diagonals, diagonals[:, self.link_map[0]])
            chain = replace(chain, diagonals=own)
        return replace(self, diagonals=diagonals, link_side=chain)

    def with_inertia(self, index: int, body: Body) -> ModelArrays:
        """Return the same bodies, the inertia of one body of the tree another."""
        at = int(self.topology[self.body_rows[index], layout.BODY_CONSTANTS]) + layout.MASS
        constants = self.constants.copy()
        constants[at : at + 10] = body_inertia(body, self.body_axes(index))
        chain = self.link_side
        chain = None if chain is None else chain.with_inertia(index, body)
        return replace(self, constants=constants, link_side=chain)

    def without_link_side(self) -> ModelArrays:
        """Return the same bodies, all of which the kernels then go through."""
        return replace(self, link_side=None, link_map=None)

    def body_axes(self, body: int) -> Array:
        """Return the kernels' axes (3, 3) of a body of the tree, seen from its frame."""
        return self.axes[self.body_rows[body] - 1]


def inertia_row(inertia: RigidInertia, axes: Array) -> Array:
    """Return mass, first moment and inertia (10,) as the kernels want them, in a body's axes."""
    upper = (axes.T @ inertia.inertia @ axes)[np.triu_indices(3)]
    return np.concatenate([[inertia.mass], axes.T @ inertia.first_moment, upper])


def rigid_inertia(row: Array, axes: Array) -> RigidInertia:
    """Return the inertia of a row (10,) that `inertia_row` has made."""
    upper = np.zeros((3, 3))
    upper[np.triu_indices(3)] = row[4:]
    inertia = upper + upper.T - np.diag(np.diag(upper))
    return RigidInertia(float(row[0]), axes @ row[1:4], axes @ inertia @ axes.T)


def body_inertia(body: Body, axes: Array) -> Array:
    """Return the row (10,) of a body's inertia, and of its beam if that stays straight."""
    row = inertia_row(body.inertia, axes)
    if (beam := body.beam) is None or is_flexible(body):
        return row
    rod = beam_inertia(beam.mass_per_length, beam.length, 0.0, beam.mass_along)
    return row + inertia_row(rod, axes)


def is_flexible(body: Body) -> bool:
    """Say whether a body has amplitudes."""
    return body.amplitudes > 0


class _ArrayBuilder:
    """One pass over the tree that fills rows, constants and workspace offsets."""

    def __init__(self, tree: Tree, gravity: Array, geometric: bool) -> None:
        self.tree = tree
        self.geometric = geometric
        self.constants: list[Array] = [gravity, np.array([SLIP_RATE])]
        self.real_size = layout.HEADER
        self.work_size = layout.BLOCK + layout.BLOCK_SIZE  # the base's
        self.coordinate = 0
        self.axes: list[Array] = []
        self.body_rows: list[int] = []
        self.joint_rows: dict[str, int] = {}  # of the body that each joint's coordinate moves
        self.rows = [np.zeros(layout.TOPOLOGY_COLUMNS, dtype=np.int64)]

    def append(self, *parts: Array) -> int:
        """Append constants and return where they start."""
        start = self.real_size
        for part in parts:
            self.constants.append(np.asarray(part, dtype=np.float64).ravel())
            self.real_size += self.constants[-1].size
        return start

    def reserve(self, size: int) -> int:
        """Reserve workspace and return where it starts."""
        start = self.work_size
        self.work_size += size
        return start

    def attach(self, row: NDArray[np.int64], attachment: Attachment) -> Array:
        """Fill a row's carrier and section; return the placement that is left."""
        if attachment.body < 0:
            return attachment.placement
        row[layout.PARENT] = self.body_rows[attachment.body]
        carrier = self.tree.bodies[attachment.body]
        axes = self.axes[row[layout.PARENT] - 1]
        if attachment.section:
            assert carrier.modes is not None
            row[layout.SECTION] = self.append(
                section_of_modes(carrier.modes, attachment.section, axes, self.geometric)
            )
            row[layout.SECTION_WORK] = self.reserve(layout.COLUMNS + 6 * carrier.modes.count)
            moved: Array = attachment.placement.copy()
            moved[:3] = axes.T @ moved[:3]
            return moved
        if attachment.station == 0.0 or not is_flexible(carrier):
            moved = attachment.placement.copy()
            moved[0, 3] += attachment.station
            moved[:3] = axes.T @ moved[:3]
            return moved
        assert carrier.beam is not None
        row[layout.SECTION] = self.append(
            section_constants(carrier.beam, attachment.station, self.geometric)
        )
        modes = sum(carrier.beam.modes)
        row[layout.SECTION_WORK] = self.reserve(layout.COLUMNS + 6 * modes)
        return attachment.placement

    def body(self, body: Body) -> None:
        """Write one body, and before it the motor side of an elastic joint, or a floating base."""
        row = np.zeros(layout.TOPOLOGY_COLUMNS, dtype=np.int64)
        placement = self.attach(row, body.attachment)
        if body.floating:
            row, placement = self.float_on(row, placement, body.attachment)
        if body.joint is not None:
            self.joint_rows[body.joint.name] = len(self.rows)
        if body.joint is not None and body.joint.spring is not None:
            motor = Body(body.name, body.attachment, body.joint, np.eye(4), RigidInertia())
            self.moving(row, placement, motor)
            row = np.zeros(layout.TOPOLOGY_COLUMNS, dtype=np.int64)
            row[layout.PARENT] = len(self.rows) - 1
            placement = pose_of(rotation=self.axes[-1].T)
        self.body_rows.append(len(self.rows))
        self.moving(row, placement, body)

    def float_on(
        self, row: NDArray[np.int64], placement: Array, at: Attachment
    ) -> tuple[NDArray[np.int64], Array]:
        """Write the massless bodies before a floating one; return its row and its placement."""
        turn = pose_of(rotation=TURNING_AXES)
        parts = (
            (True, placement, SLIDING_MODES, SLIDING_SECTION, turn),
            (False, turn, TURNING_MODES, TURNING_SECTION, turn.T),
        )
        for slides, place, modes, section, following in parts:
            row[[layout.NY, layout.NZ, layout.NT]] = modes
            row[layout.MODES], row[layout.POINTS] = sum(modes), 1
            row[layout.BEAM] = self.append(*massless_modes(modes))
            row[layout.BEAM_WORK] = self.reserve(sum(modes) + 3 + modes[0] + modes[1])
            self.moving(row, place, massless_body(at, slides))
            row = np.zeros(layout.TOPOLOGY_COLUMNS, dtype=np.int64)
            row[layout.PARENT] = len(self.rows) - 1
            row[layout.SECTION] = self.append(section)
            row[layout.SECTION_WORK] = self.reserve(layout.COLUMNS + 6 * sum(modes))
            placement = following
        return row, placement

    def moving(self, row: NDArray[np.int64], placement: Array, body: Body) -> None:
        """Write a row that moves by a body's joint, given its carrier and its placement there."""
        points = None
        if body.modes is not None:
            points = component_points(body.modes, body.joint, self.geometric)
        axes = joint_axes(body, is_flexible(body)) if points is None else points.axes
        self.axes.append(axes)
        frame = body.frame.copy()
        frame[:3, :3] = frame[:3, :3] @ axes
        row[layout.MOTION] = motion_kind(body, frame)
        row[layout.COORDINATE] = self.coordinate
        row[layout.JOINT] = int(row[layout.MOTION] != layout.FIXED)
        inertia = body_inertia(body, axes)
        row[layout.BODY_CONSTANTS] = self.append(*pose_constants(body, placement, frame), inertia)
        row[layout.WORK] = self.reserve(layout.BODY_WORK)
        if points is not None:
            self.components(row, points)
        elif is_flexible(body):
            self.beam(row, body)
        modes = int(row[layout.MODES])
        eliminated = int(row[layout.JOINT]) + modes
        row[layout.INERTIA_WORK] = self.reserve((6 + modes) ** 2 if modes else layout.BLOCK_SIZE)
        row[layout.ELIMINATED] = self.reserve(eliminated * (6 + eliminated + 1))
        carried = int(self.rows[row[layout.PARENT]][layout.MODES])
        row[layout.DERIVED] = self.reserve(
            derivative_layout.SEEN + derivative_layout.SEEN_SIZE * carried
        )
        row[layout.OWN] = self.reserve(derivative_layout.own_size(modes))
        self.coordinate += eliminated
        self.rows.append(row)

    def beam(self, row: NDArray[np.int64], body: Body) -> None:
        """Write a body's beam."""
        assert body.beam is not None
        points = beam_points(body.beam, self.geometric)
        row[[layout.NY, layout.NZ, layout.NT]] = body.beam.modes
        row[layout.MODES] = sum(body.beam.modes)
        row[layout.POINTS] = len(points)
        row[layout.BEAM] = self.append(*polar_constants(body.beam), points)
        bending = int(row[layout.NY] + row[layout.NZ])
        row[layout.BEAM_WORK] = self.reserve(int(row[layout.MODES]) + len(points) * (3 + bending))

    def components(self, row: NDArray[np.int64], points: ComponentPoints) -> None:
        """Write a body's component modes."""
        row[layout.MODES] = row[layout.COMPONENTS] = points.modes
        row[layout.POINTS], row[layout.BENT] = points.count, points.bent
        row[layout.BEAM] = self.append(points.constants)
        size = points.modes + (3 + points.modes) * 3 * points.count
        row[layout.BEAM_WORK] = self.reserve(size)

    def derivatives(self) -> None:
        """Reserve the storage of the derivatives over all coordinates."""
        slots = mark_branches(self.rows)
        size = derivative_layout.base_size(self.coordinate, slots)
        base = self.rows[0]
        base[layout.DERIVED] = self.reserve(size)
        base[derivative_layout.ROW_LENGTH] = derivative_layout.row_length(self.coordinate)
        beams = [row[[layout.NY, layout.NZ, layout.POINTS]] for row in self.rows[1:]]
        sizes = [derivative_layout.scratch_size(*beam) for beam in beams]
        sizes += [derivative_layout.component_scratch_size(int(beam[2])) for beam in beams]
        scratch = max(sizes, default=0)
        base[derivative_layout.BEAM_SCRATCH] = self.reserve(scratch)

    def frame(self, attachment: Attachment) -> None:
        """Write one frame."""
        row = np.zeros(layout.TOPOLOGY_COLUMNS, dtype=np.int64)
        placement = self.attach(row, attachment)
        row[layout.BODY_CONSTANTS] = self.append(pose_rows(placement[:3, :3], placement[:3, 3]))
        row[layout.WORK] = self.reserve(layout.BODY_WORK)
        self.rows.append(row)

    def constraints(self, frame_rows: dict[str, int]) -> tuple[str, ...]:
        """Write loops and mimic joints; return each row's name."""
        made = constraints_to_arrays(
            self.tree, self.rows, self.joint_rows, frame_rows, self.real_size
        )
        self.append(*made.constants)
        base = self.rows[0]
        base[constraint_layout.CONSTRAINTS] = len(made.topology)
        base[constraint_layout.FIRST_CONSTRAINT] = len(self.rows)
        base[constraint_layout.ROWS] = made.rows
        base[constraint_layout.AXIS_ROWS] = made.axis_rows
        size = constraint_layout.work_size(made.rows, made.axis_rows, self.coordinate)
        places = lay_out(size, made.rows, made.axis_rows, len(made.topology), self.coordinate)
        base[constraint_layout.CONSTRAINTS_WORK] = self.reserve(places.end if made.rows else 0)
        self.rows += made.topology
        return made.names


def to_arrays(tree: Tree, gravity: Array, geometric_stiffness: bool) -> ModelArrays:
    """Write a tree to flat arrays.

    Parameters
    ----------
    gravity : (3,) [m/s^2], base frame
    geometric_stiffness : bool
        False drops the foreshortening u_x (the book's slow-motion model).
    """
    builder = _ArrayBuilder(tree, gravity, geometric_stiffness)
    for body in tree.bodies:
        builder.body(body)
    builder.derivatives()
    for attachment in tree.frames.values():
        builder.frame(attachment)
    for sensor in tree.inertial_sensors:
        builder.frame(sensor.mount)
    bodies = len(builder.axes)
    frame_rows = {name: 1 + bodies + k for k, name in enumerate(tree.frames)}
    mounts = [sensor.frame for sensor in tree.inertial_sensors]
    mount_rows = {name: 1 + bodies + len(frame_rows) + k for k, name in enumerate(mounts)}
    constraint_names = builder.constraints(frame_rows)
    coordinates, joints, indices = names(tree)
    rigid = without_springs(tree) if has_springs(tree) else None
    return ModelArrays(
        topology=np.array(builder.rows, dtype=np.uint32),
        constants=np.concatenate(builder.constants),
        diagonals=diagonals(tree),
        bodies=bodies,
        body_rows=tuple(builder.body_rows),
        work_size=builder.work_size,
        frame_rows=frame_rows,
        mount_rows=mount_rows,
        axes=tuple(builder.axes),
        coordinate_names=tuple(coordinates),
        joint_names=tuple(joints),
        joint_indices=np.array(indices, dtype=np.int64),
        base_indices=base_indices(tree, coordinates),
        constraint_names=constraint_names,
        link_side=to_arrays(rigid, gravity, geometric_stiffness) if rigid else None,
        link_map=link_map(tree) if rigid else None,
    )


# branches of the tree ---------------------------------------------------------------------------

Row = NDArray[np.int64]


def mark_branches(rows: Sequence[Row]) -> int:
    """Fill in the branches in the rows of the base and the bodies.

    Parameters
    ----------
    rows : (1 + bodies) rows, depth first
        Rows so far; BRANCH_END, RUN, SIBLING and SLOT are written.

    Returns
    -------
    slots : int
        How many right-hand sides are under way at once where branches meet.
    """
    latest: dict[int, int] = {}  # the last child so far of each carrier
    for i, row in enumerate(rows[1:], start=1):
        parent = int(row[layout.PARENT])
        row[layout.BRANCH_END] = row[layout.COORDINATE] + row[layout.JOINT] + row[layout.MODES]
        row[layout.RUN] = rows[i - 1][layout.RUN] if parent == i - 1 and i > 1 else i
        row[layout.SIBLING] = latest.get(parent, 0)
        latest[parent] = i
    for row in reversed(rows[1:]):
        carrier = rows[int(row[layout.PARENT])]
        carrier[layout.BRANCH_END] = max(carrier[layout.BRANCH_END], row[layout.BRANCH_END])
    for i, row in enumerate(rows[1:], start=1):
        parent = int(row[layout.PARENT])
        apart = parent > 0 and latest[parent] != i
        row[layout.SLOT] = rows[parent][layout.SLOT] + int(apart)
    return 1 + max((int(row[layout.SLOT]) for row in rows[1:]), default=0)
