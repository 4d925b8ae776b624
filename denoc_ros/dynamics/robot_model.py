"""The data of a robot: one immutable model, its payloads and one workspace."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from denoc_ros.dynamics.base.base_motion import AT_REST, Base, BaseMotion, as_base_motion
from denoc_ros.dynamics.elastic.section import AnySection
from denoc_ros.dynamics.singular_inertia import coordinates_without_inertia
from denoc_ros.dynamics.validation import as_vector, require_finite, require_rotors
from denoc_ros.errors import SolverError, StateError
from denoc_ros.kernels.constraints import closing, closure, constrained
from denoc_ros.kernels.dynamics import articulated, composite, inverse, world
from denoc_ros.kernels.jit import handle
from denoc_ros.kernels.jit import handle as rec_
from denoc_ros.kernels.jit.array_object import FLOAT64, array_type
from denoc_ros.kernels.jit.compiled import ready
from denoc_ros.kernels.jit.handle import GOOD, NOT_FINITE, SINGULAR
from denoc_ros.kernels.layout import layout
from denoc_ros.kernels.layout import layout as at_
from denoc_ros.kernels.springs.link_side_dynamics import STATES as LINK_STATES
from denoc_ros.model.arrays import ModelArrays, inertia_row, rigid_inertia, to_arrays
from denoc_ros.model.coordinates import diagonals
from denoc_ros.model.inertia import (
    difference,
    from_centre,
    inverse_transform,
    moved,
    possible,
    total,
)
from denoc_ros.model.numbers import with_numbers
from denoc_ros.model.overrides import with_overrides
from denoc_ros.model.payloads import INERTIA_RULE, NO_PAYLOAD
from denoc_ros.model.tree import RigidInertia, Tree
from denoc_ros.types import Array

Int = NDArray[np.int64]
ARRAY_TYPE = array_type()


class Workspace:
    """One caller's workspace over a arrays model.

    Parameters
    ----------
    constants : (constants,)
        The model's constants; shared, so that a payload set live is seen by all.
    link_side : ndarray, optional
        Those of the robot without springs, where joints are elastic.

    Attributes
    ----------
    handle : int
        What kernels take for the model; valid as long as this object lives.
    work : (work_size,)
    """

    def __init__(
        self, arrays: ModelArrays, constants: Array, link_side: Array | None = None
    ) -> None:
        self.work: Array = np.zeros(arrays.work_size)
        self._gravity = constants[layout.GRAVITY : layout.GRAVITY + 3]
        self.work[layout.BASE_GRAVITY : layout.BASE_GRAVITY + 3] = self._gravity
        self.work[layout.ACCELERATION : layout.ACCELERATION + 3] = -self._gravity
        self.work[layout.WORLD_ROTATION : layout.WORLD_ROTATION + 9] = np.eye(3).ravel()
        self._diagonals = np.zeros((handle.DIAGONALS, arrays.n))
        self._diagonals[: len(arrays.diagonals)] = arrays.diagonals
        self._alive: tuple[object, ...] = (arrays.topology, constants)
        record = np.zeros(handle.RECORD, dtype=np.int64)
        record[handle.TOPOLOGY_ADDRESS] = arrays.topology.ctypes.data
        record[handle.CONSTANTS_ADDRESS] = constants.ctypes.data
        record[handle.WORK_ADDRESS] = self.work.ctypes.data
        record[handle.DIAGONALS_ADDRESS] = self._diagonals.ctypes.data
        record[handle.COORDINATES] = arrays.n
        record[handle.BODIES] = arrays.bodies
        record[handle.TOPOLOGY_LENGTH] = arrays.topology.size
        record[handle.CONSTANTS_LENGTH] = constants.size
        record[handle.WORK_LENGTH] = self.work.size
        record[handle.ARRAY_TYPE] = ARRAY_TYPE
        record[handle.ELEMENT_TYPE] = id(FLOAT64)
        self._record = record
        self.handle = int(record.ctypes.data)
        self._see_link_side(arrays, link_side)
        self._hybrid: tuple[Array, Array] | None = None
        self._splits: dict[tuple[int, ...], Split] = {}

    def move_base(self, twist: Array, acceleration: Array, rotation: Array | None) -> None:
        """Let the base move: twist and acceleration (6,) in its axes, rotation (3, 3) to world."""
        work = self.work
        gravity = self._gravity if rotation is None else self._gravity @ rotation
        work[layout.BASE_GRAVITY : layout.BASE_GRAVITY + 3] = gravity
        work[layout.VELOCITY : layout.VELOCITY + 3] = twist[:3]
        work[layout.ANGULAR_VELOCITY : layout.ANGULAR_VELOCITY + 3] = twist[3:]
        work[layout.ACCELERATION : layout.ACCELERATION + 3] = acceleration[:3] - gravity
        work[layout.ANGULAR_ACCELERATION : layout.ANGULAR_ACCELERATION + 3] = acceleration[3:]
        if self._chain is not None:
            self._chain.move_base(twist, acceleration, rotation)

    def take_diagonals(self, arrays: ModelArrays) -> None:
        """Go on with other terms along the coordinates, of a model that is the same otherwise."""
        self._diagonals[: len(arrays.diagonals)] = arrays.diagonals
        if self._chain is not None and arrays.link_side is not None:
            self._chain.take_diagonals(arrays.link_side)

    def _see_link_side(self, arrays: ModelArrays, constants: Array | None) -> None:
        """Name the robot without springs in the record: this one where there are none."""
        self._record[handle.LINK_SIDE] = self.handle
        self._chain: Workspace | None = None
        if arrays.link_side is None or arrays.link_map is None or constants is None:
            return
        self._chain = type(self)(arrays.link_side, constants)
        self._states: Array = np.zeros((LINK_STATES, arrays.link_side.n))
        self._record[handle.LINK_SIDE] = self._chain.handle
        self._record[handle.LINK_MAP] = arrays.link_map.ctypes.data
        self._record[handle.LINK_STATES] = self._states.ctypes.data
        self._alive = (*self._alive, arrays.link_map)

    def hybrid(self) -> tuple[Array, Array]:
        """Return where hybrid derivatives take one state (1, 4, n) and leave their matrices."""
        if self._hybrid is None:
            n = self._diagonals.shape[1]
            self._hybrid = np.empty((1, 4, n)), np.empty((1, n * (4 * n + 1)))
        return self._hybrid

    def split(self, index: Int) -> Split:
        """Return how prescribed joints, index (h,), split the coordinates; kept for next time."""
        key = tuple(index.tolist())
        if key not in self._splits:
            self._splits[key] = Split(index, self._diagonals.shape[1])
        return self._splits[key]


class Split:
    """Coordinates split into h prescribed joints and the f others.

    Attributes
    ----------
    index : (h,)
    free : (f,)
    flags : (n,)
        1 at the joints.
    """

    def __init__(self, index: Int, n: int) -> None:
        self.index, self.free = index, np.setdiff1d(np.arange(n), index)
        self.flags: Array = np.zeros(n)
        self.flags[index] = 1.0

    @cached_property
    def places(self) -> tuple[Int, ...]:
        """Where the parts of HybridDerivatives stand in the kernel's matrices."""
        n, index, free = len(self.flags), self.index, self.free
        every, by = np.arange(n), (0, 1, 2, 2)
        return tuple(
            (n * n * matrix + n * rows[:, None] + columns[None, :]).ravel()
            for rows in (index, free)
            for matrix, columns in zip(by, (every, every, index, free), strict=True)
        )


KERNELS = (
    inverse.inverse_dynamics,
    articulated.forward_dynamics,
    articulated.articulated_dynamics,
    composite.inertia_matrix,
    composite.energies,
    world.frame_pose,
    world.frame_jacobian,
    world.place_bodies,
)
CONSTRAINT_KERNELS = (
    closure.closure,
    closure.closure_jacobian,
    constrained.constrained_dynamics,
    closing.advance_tied,
)


class WithOverrides(Protocol):
    """The numbers that an identification found."""

    @property
    def overrides(self) -> Mapping[str, Any]:
        """Numbers of a robot by dotted path."""


Held = TypeVar('Held', bound='RobotModel')


class RobotModel:
    """A robot and its workspace; :class:`denoc_ros.dynamics.robot.Robot` adds the verbs.

    Attributes
    ----------
    tree : Tree
    n : int
    joint_names, coordinate_names : tuple of str
    joint_indices, flexible_indices, base_indices : int arrays
        Where joints, amplitudes and the coordinates of a floating base (none: empty) stand.
    free_indices : int array
        All that no joint drives: amplitudes and the coordinates of a floating base.
    gravity : (3,) [m/s^2] in the base frame
    geometric_stiffness : bool
    frame_names : tuple of str, links and loop frames
    constraint_names : tuple of str, the loop or mimic joint of each constraint row
    """

    def __init__(
        self,
        tree: Tree,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
        geometric_stiffness: bool = True,
    ) -> None:
        self.tree = tree
        self.gravity = as_vector('gravity', gravity, (3,)).copy()
        self.gravity.setflags(write=False)
        self.geometric_stiffness = bool(geometric_stiffness)
        self._adopt(to_arrays(self._modelled(tree), self.gravity, self.geometric_stiffness))
        self._payloads: dict[str, Array] = {}
        self._load_factors: dict[str, float] = {}

    @staticmethod
    def _modelled(tree: Tree) -> Tree:
        """Return the part of a robot that is modelled: all of it."""
        return tree

    def _adopt(self, arrays: ModelArrays) -> None:
        # in one call: processes that start beside each other share what is known to be missing
        ready(*KERNELS, *(CONSTRAINT_KERNELS if arrays.constraint_names else ()))
        self.arrays = arrays
        self.n = arrays.n
        self.joint_names = arrays.joint_names
        self.frame_names = tuple(arrays.frame_rows)
        self.constraint_names = arrays.constraint_names
        self.coordinate_names = arrays.coordinate_names
        self.joint_indices = arrays.joint_indices
        self.base_indices = arrays.base_indices
        self.free_indices = np.delete(np.arange(self.n), self.joint_indices)
        self.flexible_indices = np.delete(
            np.arange(self.n), np.concatenate([self.joint_indices, self.base_indices])
        )
        self._constants: Array = arrays.constants.copy()
        self._base: BaseMotion | None = None
        self._link_side: Array | None = None  # the constants of the robot without springs
        if arrays.link_side is not None:
            self._link_side = arrays.link_side.constants.copy()
        self._use(self.new_workspace())
        self._zero = np.zeros(self.n)
        self._square = (self.n, self.n)  # of a matrix over the coordinates
        self._sections: dict[tuple[str, float | None], tuple[AnySection, slice]] = {}

    def _use(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self.handle = workspace.handle

    @property
    def stiffness(self) -> Array:
        """Modal stiffness (n,) of the amplitudes [N/m or N m/rad], 0 for joints."""
        return self._diagonal(rec_.STIFFNESS)

    @property
    def damping(self) -> Array:
        """Viscous damping (n,) of joints and amplitudes [N s/m or N m s/rad]."""
        return self._diagonal(rec_.DAMPING)

    @property
    def friction(self) -> Array:
        """Coulomb friction (n,) of joints [N or N m]."""
        return self._diagonal(rec_.FRICTION)

    @property
    def armature(self) -> Array:
        """Rotor inertia (n,) of joints behind their gears [kg m^2 or kg]."""
        return self._diagonal(rec_.ARMATURE)

    @property
    def slip_rate(self) -> float:
        """Rate at which Coulomb friction has risen to tanh 1 [rad/s or m/s]."""
        return float(self.arrays.constants[at_.SLIP_RATE])

    def _diagonal(self, row: int) -> Array:
        diagonal: Array = self.arrays.diagonals[row]
        return diagonal

    @property
    def constants(self) -> Array:
        """The model's constants as the kernels read them, payloads included."""
        return self._constants

    @property
    def work(self) -> Array:
        """The workspace of the kernels, with the layout of `kernels.layout`."""
        work: Array = self._workspace.work
        return work

    def new_workspace(self) -> Workspace:
        """Return another workspace over this model, with the same base motion, for a thread."""
        workspace = Workspace(self.arrays, self._constants, self._link_side)
        if self._base is not None:
            workspace.move_base(*self._base.for_kernels())
        return workspace

    @property
    def base_motion(self) -> BaseMotion | None:
        """The present motion of the base; None: it is at rest."""
        return self._base

    def move_base(self, base: Base | None) -> None:
        """Set the motion of the base for every verb from now on; live, no allocation of a model.

        Parameters
        ----------
        base : (twist, acceleration) or (twist, acceleration, pose), or None
            Of the base frame, as :class:`BaseMotion` says; one motion, not rows. None: at rest.

        Raises
        ------
        StateError
            For a wrong shape, a number that is not finite, or a pose that is no rigid one.
        """
        if base is None and self._base is None:
            return
        motion = None if base is None else as_base_motion(base)
        if motion is not None and motion.rows is not None:
            raise StateError(f'base must be one motion, got {motion.rows} rows')
        self._base = motion
        self._workspace.move_base(*(motion or AT_REST).for_kernels())

    @contextmanager
    def on_base(self: Held, base: Base | None) -> Iterator[Held]:
        """Let the base move for every verb of a `with` block; then the motion before goes on.

        A verb's own `base` goes before it. Parameters and errors are those of `move_base`; rows of
        motions, one for each row of the states, are for the verbs' `base` alone.

        Yields
        ------
        Robot
            This one.
        """
        before = self._base
        self.move_base(base)
        try:
            yield self
        finally:
            self.move_base(before)

    def copy(self: Held) -> Held:
        """Return a copy with the same payloads and base motion, and its own workspace."""
        other = self._of_arrays(self.arrays, self.tree)
        other._constants[:] = self._constants
        if other._link_side is not None and self._link_side is not None:
            other._link_side[:] = self._link_side
        other._payloads = dict(self._payloads)
        other._load_factors = dict(self._load_factors)
        other.move_base(self._base)
        return other

    def _of_arrays(self: Held, arrays: ModelArrays, tree: Tree) -> Held:
        """Return a robot like this one of other arrays; its payloads and base come after that."""
        other = type(self).__new__(type(self))
        other.__dict__.update(self.__dict__, tree=tree)
        other._adopt(arrays)
        return other

    def __reduce__(self) -> tuple[Any, ...]:
        # a handle is an address: it must not travel to a copy or to another process
        arguments = (self.tree, self.gravity, self.geometric_stiffness)
        state = {'payloads': self._payloads, 'factors': self._load_factors, 'base': self._base}
        return type(self), arguments, state

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._set_loads(state['payloads'], state['factors'])
        self.move_base(state['base'])

    def with_overrides(self: Held, overrides: Mapping[str, Any]) -> Held:
        """Return a robot with other parameters, by dotted paths such as `beam.arm.y.ei`.

        Payloads that were set and scaled loads stay, and the base moves as it does.

        Raises
        ------
        ConfigError
            A path that names nothing, or a value that makes no model.
        """
        changed = with_numbers(self.tree, overrides)
        if changed is not None:
            return with_numbers_of(self, changed)
        tree = with_overrides(self.tree, overrides)
        other = type(self)(tree, self.gravity, self.geometric_stiffness)
        other._take_payloads(self)
        other.move_base(self._base)
        return other

    def apply(self: Held, found: WithOverrides) -> Held:
        """Return the robot with the numbers that an identification found.

        Parameters
        ----------
        found : object with `overrides`
            Such as :func:`denoc_ros.identify` and :func:`denoc_ros.identify_model` return.
        """
        return self.with_overrides(found.overrides)

    def set_payload(
        self, frame: str, mass: float, com: ArrayLike = (0, 0, 0), inertia: ArrayLike | None = None
    ) -> None:
        """Set the rigid payload of a frame, which replaces the one set before; live.

        It adds to a payload that the model has (`<payload>` and overrides `payload.*`).

        Parameters
        ----------
        frame : link name
        mass : float [kg]
        com : (3,) [m] in the frame
        inertia : (3, 3) [kg m^2] about the centre of mass, frame axes; default a point mass
        """
        row = self._carrier(frame)
        attachment = self.tree.frames.get(frame)
        if row == 0 or attachment is None or attachment.deforms:
            raise StateError(f'frame {frame!r} must be a link that moves, got one that does not')
        payload = payload_inertia(attachment.placement, mass, com, inertia)
        self._payloads[frame] = inertia_row(payload, self.arrays.axes[row - 1])
        self._load_body(row)

    def with_modelled_payloads(self: Held) -> Held:
        """Return a robot whose set payloads are its model's: overrides `payload.*`.

        What a model has on the same frames is added. Other overrides then reach all of a payload.
        """
        if not self._payloads:
            return self
        overrides: dict[str, Any] = {}
        for frame, row in self._payloads.items():
            at = self.tree.frames[frame]
            set_load = rigid_inertia(row, self.arrays.body_axes(at.body))
            load = moved(set_load, inverse_transform(at.placement))
            if (own := self.tree.payloads.get(frame)) is not None:
                load = total(load, from_centre(own.mass, own.com, own.inertia))
            com = load.first_moment / load.mass if load.mass > 0.0 else np.zeros(3)
            about = difference(load, from_centre(load.mass, com, np.zeros((3, 3)))).inertia
            overrides[f'payload.{frame}.mass'] = load.mass
            overrides[f'payload.{frame}.com'] = com.tolist()
            overrides[f'payload.{frame}.inertia'] = about.ravel().tolist()
        other = self.with_overrides(overrides)
        other._payloads = {}
        for frame in self._payloads:
            other._load_body(other._carrier(frame))
        return other

    def diagonals(self) -> Array:
        """Return a copy of stiffness, damping, friction and armature, as `set_diagonals` takes."""
        copied: Array = self.arrays.diagonals.copy()
        return copied

    def set_diagonals(self, diagonals: Array) -> None:
        """Set stiffness, damping, friction and armature, rows as of the model's arrays; live.

        The array is kept: it must not change later.
        """
        self.arrays = self.arrays.with_diagonals(diagonals)
        self._workspace.take_diagonals(self.arrays)

    def add_payload(self, frame: str, row: Array) -> None:
        """Add an inertia (10,), as kernels have it, to the payload of a frame; live."""
        self._payloads[frame] = self._payloads.get(frame, np.zeros(10)) + row
        carrier = self._carrier(frame)
        added = row * self._load_factor(carrier)
        for _, constants, at in self._inertias(carrier):
            constants[at : at + 10] += added

    def payload_mass(self, frame: str) -> float:
        """Mass [kg] of the payload on a frame: the model's and what was set; 0 without one."""
        own, row = self.tree.payloads.get(frame, NO_PAYLOAD), self._payloads.get(frame)
        return own.mass + (0.0 if row is None else float(row[0]))

    def _take_payloads(self, other: RobotModel) -> None:
        """Carry the payloads and scaled loads of another robot with the same links."""
        self._set_loads(other._payloads, other._load_factors)

    def _set_loads(self, payloads: Mapping[str, Array], factors: Mapping[str, float]) -> None:
        self._payloads, self._load_factors = dict(payloads), dict(factors)
        for frame in {**payloads, **factors}:
            self._load_body(self._carrier(frame))

    def with_scaled_load(self: Held, frame: str, factor: float) -> Held:
        """Return a copy with a scaled load at a frame, for checks with inexact models.

        The inertia of the body that carries the frame, payloads included, is multiplied by the
        factor; of a beam only what is rigid on its root. Overrides and payloads that are set later
        leave it scaled.
        """
        if not (np.isfinite(factor) and factor > 0.0):
            raise StateError(f'load at {frame!r}: factor must be > 0, got {factor}')
        other = self.copy()
        other._load_factors[frame] = factor * other._load_factors.get(frame, 1.0)
        other._load_body(other._carrier(frame))
        return other

    def _load_factor(self, row: int) -> float:
        """Return how many times its inertia a body counts."""
        at_body = [f for frame, f in self._load_factors.items() if self._carrier(frame) == row]
        return float(np.prod(at_body))

    def payload_centre(self, frame: str) -> Array | None:
        """Return the centre of mass (3,) of a frame's set payload in its axes; None: none."""
        row = self._payloads.get(frame)
        if row is None or row[0] == 0.0:
            return None
        at = self.tree.frames[frame]
        centre = self.arrays.body_axes(at.body) @ (row[1:4] / row[0])
        return np.asarray(at.placement[:3, :3].T @ (centre - at.placement[:3, 3]))

    def _carrier(self, frame: str) -> int:
        return int(self.arrays.topology[self._row(frame), at_.PARENT])

    def _load_body(self, row: int) -> None:
        """Write a body's inertia with the payloads that it carries, scaled as it was asked."""
        carried = [load for name, load in self._payloads.items() if self._carrier(name) == row]
        factor = self._load_factor(row)
        for arrays, constants, at in self._inertias(row):
            constants[at : at + 10] = factor * sum(carried, arrays.constants[at : at + 10])

    def _inertias(self, row: int) -> Iterator[tuple[ModelArrays, Array, int]]:
        """Yield where a body's inertia stands: the arrays, the constants in use, the offset."""
        body = self.arrays.body_rows.index(row)
        for arrays, constants in (
            (self.arrays, self._constants),
            (self.arrays.link_side, self._link_side),
        ):
            if arrays is not None and constants is not None:
                own = arrays.topology[arrays.body_rows[body], at_.BODY_CONSTANTS]
                yield arrays, constants, int(own) + at_.MASS

    def held(self, index: NDArray[np.int64]) -> Array:
        """Return the (n,) flags by which kernels know the joints whose motion is given."""
        flags = np.zeros(self.n)
        flags[index] = 1.0
        return flags

    def indices(self, names: Sequence[str]) -> NDArray[np.int64]:
        """Return the coordinate indices of joints; StateError for unknown or repeated names."""
        unknown = [name for name in names if name not in self.joint_names]
        if unknown or len(set(names)) != len(names):
            raise StateError(
                f'joints must be different ones of {self.joint_names}, got {tuple(names)}'
            )
        return self.joint_indices[[self.joint_names.index(name) for name in names]]

    def _row(self, frame: str) -> int:
        arrays = self.arrays
        row = arrays.frame_rows.get(frame, arrays.mount_rows.get(frame))
        if row is None:
            known = ', '.join(self.frame_names)
            raise StateError(f'frame must be one of {known}, got {frame!r}')
        return row

    @property
    def gravity_in_base(self) -> Array:
        """Gravity (3,) [m/s^2] in the base's axes: of a base that moves by its pose."""
        pose = None if self._base is None else self._base.pose
        return self.gravity if pose is None else np.asarray(pose[:3, :3].T @ self.gravity)

    def raise_for_status(self, status: int, **arguments: Array) -> None:
        """Raise the error of a kernel's status about its arguments."""
        self._raise_for_status(status, True, **arguments)

    def _raise_for_status(self, status: int, check: bool, **arguments: Array) -> None:
        if status == GOOD or (status == NOT_FINITE and not check):
            return
        require_finite(arguments)
        if status == SINGULAR:
            require_rotors(self.tree)
            lacking = coordinates_without_inertia(self, arguments.get('q'))
            which = next((f' of {name!r}: {remedy}' for name, remedy in lacking.items()), '')
            rule = 'the inertia must be positive definite, got none'
            raise SolverError(f'{self.tree.name}: {rule}{which}')
        raise StateError('the result must be finite, got an overflow from finite arguments')


def with_numbers_of(robot: Held, tree: Tree) -> Held:
    """Return the robot of a tree that differs from its own in numbers: no arrays are built anew.

    Terms along the coordinates and inertias of bodies are the tree's. Payloads that were set and
    scaled loads stay, and the base moves as it does.
    """
    arrays = robot.arrays.with_diagonals(diagonals(robot._modelled(tree)))
    for index, (body, before) in enumerate(zip(tree.bodies, robot.tree.bodies, strict=True)):
        if body.inertia is not before.inertia:
            arrays = arrays.with_inertia(index, body)
    other = robot._of_arrays(arrays, tree)
    other._take_payloads(robot)
    other.move_base(robot._base)
    return other


def payload_inertia(
    placement: Array, mass: float, com: ArrayLike, inertia: ArrayLike | None
) -> RigidInertia:
    """Return a payload's inertia about the body origin, from its frame's placement on the body.

    Raises
    ------
    StateError
        The mass is negative or not finite, or no body has the inertia.
    """
    centre = as_vector('com', com, (3,))
    about = np.zeros((3, 3)) if inertia is None else as_vector('inertia', inertia, (3, 3))
    if not (np.isfinite(mass) and mass >= 0.0):
        raise StateError(f'payload mass must be >= 0 kg, got {mass}')
    scale = 1e-9 * max(1.0, float(np.abs(about).max()))
    if not np.allclose(about, about.T, atol=scale) or not possible(about):
        raise StateError(f'payload {INERTIA_RULE}, got {about.tolist()}')
    return moved(from_centre(float(mass), centre, about), placement)
