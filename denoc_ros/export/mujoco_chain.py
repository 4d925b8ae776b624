"""A robot's model for MuJoCo, in MuJoCo: its torques, equilibrium and natural frequencies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg

from denoc_ros.dynamics.linear.natural_modes import independent_joints, mechanism_modes
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError, SolverError
from denoc_ros.model.beams.segments import whole_beams
from denoc_ros.types import Array

ITERATIONS = 50
SETTLED = 1e-10  # change of a coordinate that ends Newton's iteration
DIFFERENCE = 1e-5  # rad or m, of central differences
NOTHING = 1e-14  # of the largest number of an equation: what rounding leaves of a zero
RANK = 1e-9  # of the closure Jacobian


def mujoco_module() -> Any:
    """Return MuJoCo; ConfigError where it is not installed."""
    try:
        import mujoco
    except ImportError as error:
        rule = "MuJoCo must be installed (pip install 'denoc_ros[mujoco]')"
        raise ConfigError('mujoco', [f'{rule}, got: {error}']) from error
    return mujoco


class MujocoChain:
    """A model for MuJoCo with some joints held, the others and the hinges of beams free.

    Parameters
    ----------
    text : str
        The model.
    held : mapping of str to float
        Positions of the joints that stay still [rad, m].
    start : mapping of str to float
        First guesses of other joints.
    """

    def __init__(
        self, text: str, held: Mapping[str, float], start: Mapping[str, float] | None = None
    ) -> None:
        self.mujoco = mujoco_module()
        try:
            self.model = self.mujoco.MjModel.from_xml_string(text)
        except ValueError as error:
            got = ' '.join(str(error).split())
            raise ConfigError(
                'mujoco', [f'the model must be one for MuJoCo, got: {got}']
            ) from error
        self.model.opt.jacobian = self.mujoco.mjtJacobian.mjJAC_DENSE
        self.data = self.mujoco.MjData(self.model)
        self.set_joints({**(start or {}), **held})
        fixed = [self.degree(name) for name in held]
        self.free = np.setdiff1d(np.arange(self.model.nv), fixed)

    def degree(self, joint: str) -> int:
        """Return the index of a joint among the velocities."""
        return int(self.model.jnt_dofadr[self.model.joint(joint).id])

    def set_joints(self, positions: Mapping[str, float]) -> None:
        """Set positions of joints with one coordinate [rad, m]."""
        for name, value in positions.items():
            self.data.qpos[self.model.jnt_qposadr[self.model.joint(name).id]] = value

    def inverse_dynamics(
        self,
        positions: Mapping[str, float],
        rates: Mapping[str, float],
        accelerations: Mapping[str, float],
    ) -> dict[str, float]:
        """Return the torques [N m, N] that move the open tree's joints so.

        Without what MuJoCo holds by constraints: loops, limits and friction.
        """
        data, flags = self.data, self.model.opt.disableflags
        self.set_joints(positions)
        for name in positions:
            data.qvel[self.degree(name)] = rates[name]
            data.qacc[self.degree(name)] = accelerations[name]
        self.model.opt.disableflags = flags | self.mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        self.mujoco.mj_inverse(self.model, data)
        self.model.opt.disableflags = flags
        return {name: float(data.qfrc_inverse[self.degree(name)]) for name in positions}

    def settle(self) -> None:
        """Bring the free coordinates to rest in equilibrium, constraints closed.

        Raises
        ------
        SolverError
            Newton's iteration finds none.
        """
        count, multipliers = len(self.free), np.zeros(0)
        change = np.inf
        self._multipliers = multipliers
        if not count:
            self.mujoco.mj_forward(self.model, self.data)
            return
        for _ in range(ITERATIONS):
            force, rows, error = self._force()
            if len(multipliers) != len(rows):
                multipliers = np.zeros(len(rows))
            tangent = self._stiffness(multipliers)
            matrix = np.block([[tangent, -rows.T], [rows, np.zeros((len(rows), len(rows)))]])
            residual = np.concatenate([force + rows.T @ multipliers, -error])
            size = np.abs(matrix).max(axis=1)  # of rows out of a planar robot's plane: rounding
            scale = np.where(size > NOTHING * size.max(), 1.0 / np.sqrt(size + NOTHING), 0.0)
            try:
                scaled = np.linalg.pinv(matrix * scale * scale[:, None], rcond=RANK)
            except np.linalg.LinAlgError:
                break
            step = scale * (scaled @ (scale * residual))
            self._move(step[:count])
            multipliers = multipliers + step[count:]
            change = float(np.abs(step[:count]).max(initial=0.0))
            if change <= SETTLED:
                self._multipliers = multipliers
                return
        rule = f'an equilibrium must be found in {ITERATIONS} Newton steps'
        raise SolverError(f'mujoco: {rule}, got a last step of {change:.3g}')

    def natural_modes(self) -> tuple[Array, Array]:
        """Return natural frequencies (k,) [Hz] and shapes (free, k) after `settle`.

        Ascending; rigid motions have 0, unstable ones negative frequencies. Shapes have a
        modal mass of 1.
        """
        if not len(self.free):
            return np.zeros(0), np.zeros((0, 0))
        rows = self._force()[1]
        tangent = self._stiffness(self._multipliers)
        mass = self.inertia_matrix()[np.ix_(self.free, self.free)]
        basis = scipy.linalg.null_space(rows, rcond=RANK) if len(rows) else np.eye(len(self.free))
        squares, vectors = scipy.linalg.eigh(basis.T @ tangent @ basis, basis.T @ mass @ basis)
        hertz = np.sign(squares) * np.sqrt(np.abs(squares)) / (2.0 * np.pi)
        return np.asarray(hertz), np.asarray(basis @ vectors)

    def inertia_matrix(self) -> Array:
        """Return the inertia matrix (nv, nv) where the chain stands."""
        unit = np.eye(self.model.nv)
        mass = np.zeros_like(unit)
        for row, along in zip(mass, unit, strict=True):
            self.mujoco.mj_mulM(self.model, self.data, row, along)
        return mass

    def site(self, name: str, body: str) -> Array:
        """Return the position (3,) [m] of a site in a body's frame."""
        site, frame = self.data.site(name), self.data.body(body)
        return np.asarray(frame.xmat.reshape(3, 3).T @ (site.xpos - frame.xpos))

    def sensor(self, name: str) -> Array:
        """Return a sensor's value after `settle`."""
        return np.array(self.data.sensor(name).data)

    def joint(self, name: str) -> float:
        """Return a joint's position [rad, m]."""
        return float(self.data.qpos[self.model.jnt_qposadr[self.model.joint(name).id]])

    def _move(self, step: Array) -> None:
        change = np.zeros(self.model.nv)
        change[self.free] = step
        self.mujoco.mj_integratePos(self.model, self.data.qpos, change, 1.0)
        self.mujoco.mj_forward(self.model, self.data)

    def _force(self) -> tuple[Array, Array, Array]:
        """Return the force at rest (free,), closure Jacobian (rows, free) and errors (rows,)."""
        self.data.qvel[:] = 0.0
        self.mujoco.mj_fwdPosition(self.model, self.data)
        self.mujoco.mj_fwdVelocity(self.model, self.data)
        data = self.data
        force = data.qfrc_passive - data.qfrc_bias
        rows = np.asarray(data.efc_J).reshape(-1, self.model.nv)
        equal = np.asarray(data.efc_type) == self.mujoco.mjtConstraint.mjCNSTR_EQUALITY
        return force[self.free], rows[equal][:, self.free], np.asarray(data.efc_pos)[equal]

    def _stiffness(self, multipliers: Array) -> Array:
        """Return -d(force + J^T multipliers)/dq (free, free), symmetric."""
        start, count = self.data.qpos.copy(), len(self.free)
        tangent = np.zeros((count, count))
        for k in range(count):
            pushed = []
            for sign in (1.0, -1.0):
                step = np.zeros(self.model.nv)
                step[self.free[k]] = sign * DIFFERENCE
                self.data.qpos[:] = start
                self.mujoco.mj_integratePos(self.model, self.data.qpos, step, 1.0)
                force, rows, _ = self._force()
                pushed.append(force + rows.T @ multipliers)
            tangent[:, k] = (pushed[1] - pushed[0]) / (2.0 * DIFFERENCE)
        self.data.qpos[:] = start
        self.mujoco.mj_forward(self.model, self.data)
        return np.asarray(0.5 * (tangent + tangent.T))


def vibrations(frequencies: Sequence[float] | Array, rigid: int) -> Array:
    """Return frequencies [Hz] without those of a number of rigid motions, ascending."""
    found = np.asarray(frequencies, dtype=np.float64)
    return np.sort(found[np.argsort(np.abs(found))[rigid:]])


@dataclass(frozen=True)
class TipSag:
    """Deflection [m] of a beam's tip in equilibrium, in its beam frame."""

    link: str
    ours: Array  # (3,)
    mujoco: Array  # (3,)

    @property
    def difference(self) -> float:
        """Distance of the two as a share of the larger deflection."""
        size = max(float(np.linalg.norm(tip)) for tip in (self.ours, self.mujoco))
        return float(np.linalg.norm(self.ours - self.mujoco)) / size if size > 1e-12 else 0.0


@dataclass(frozen=True)
class ChainComparison:
    """A robot beside its exported model: independent joints held, at rest in equilibrium."""

    ours: Array  # natural frequencies [Hz], ascending, without rigid motions
    mujoco: Array  # as many
    sags: tuple[TipSag, ...]


def compare(robot: Robot, text: str, q: Array) -> ChainComparison:
    """Return natural frequencies and sags of a robot and of its exported model.

    Parameters
    ----------
    robot : Robot
        Of a floating base without gravity: it falls freely.
    text : str
        As :func:`denoc_ros.export.mjcf.mjcf` writes it.
    q : ndarray (n,)
        In equilibrium, loops closed.

    Raises
    ------
    ConfigError
        MuJoCo is not installed, or does not take the model.
    SolverError
        The model has no equilibrium nearby.
    """
    looped = bool(robot.constraint_names)
    held = independent_joints(robot, q) if looped else robot.joint_names
    modes = mechanism_modes(robot, q, held) if looped else robot.natural_modes(q)
    joints = zip(robot.joint_names, robot.joint_indices, strict=True)
    positions = {name: float(q[index]) for name, index in joints}
    chain = MujocoChain(text, {name: positions[name] for name in held}, positions)
    if len(robot.base_indices):
        chain.model.opt.gravity[:] = 0.0
    chain.settle()
    rigid = len(robot.base_indices)
    ours = vibrations(modes.frequencies, rigid)
    theirs = vibrations(chain.natural_modes()[0], rigid)[: len(ours)]
    sags = []
    for whole in whole_beams(robot.tree):
        tip = chain.site(f'{whole.link}/tip', whole.link) - [whole.length, 0.0, 0.0]
        sags.append(TipSag(whole.link, robot.tip_deflection(whole.link, q), tip))
    return ChainComparison(ours, theirs, tuple(sags))
