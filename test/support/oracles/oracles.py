"""A dense model of a flexible robot straight from its energies: slow, and sharing no code.

Positions of many points of every body are written as functions of the coordinates, in power series
(test/support/oracles/jets.py): their rates, accelerations and Jacobians then give Lagrange's
equations by d'Alembert's sums, with no recursion, no propagation matrix and no modal invariant. A
beam is its Gauss points, a rigid body the four homogeneous points (position, weight) of its
pseudo-inertia's eigenvectors; torsion's kinetic energy is differentiated as Lagrange's equation
says.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jets import Jet, cos, rotation, sin, stack
from numpy.typing import NDArray

from denoc_ros.model.tree import Attachment, Beam, Body, Deformation, JointKind, RigidInertia, Tree
from denoc_ros.types import Array

SLIDE_SPEED = 1e-3  # of tanh friction [rad/s or m/s]


@dataclass(frozen=True)
class Samples:
    """Point masses of a body: local homogeneous positions, and torsion's share."""

    mass: Array  # (k,) signed
    station: Array  # (g,) Gauss stations of the beam, the first g of the k points
    weight: Array  # (g,) Gauss weights
    rigid: Array  # (4, 4) homogeneous points of the rigid rest, columns; the last 4 of the k


@dataclass(frozen=True)
class Span:
    """Where a body's coordinates are among the n."""

    joint: slice
    y: slice
    z: slice
    torsion: slice


def homogeneous_points(body: RigidInertia) -> tuple[Array, Array]:
    """Signed masses (4,) and columns [position; weight] (4, 4) with the body's pseudo-inertia."""
    pseudo = np.zeros((4, 4))
    pseudo[:3, :3] = np.trace(body.inertia) / 2 * np.eye(3) - body.inertia
    pseudo[:3, 3] = pseudo[3, :3] = body.first_moment
    pseudo[3, 3] = body.mass
    return np.linalg.eigh(pseudo)


def gauss(count: int, length: float) -> tuple[Array, Array]:
    """Gauss-Legendre stations and weights on [0, length]."""
    x, w = np.polynomial.legendre.leggauss(count)
    return (x + 1) * length / 2, w * length / 2


def slope_squares(part: Deformation, stations: Array) -> Array:
    """Integrals of s' s'^T from 0 to each station: (k, m, m)."""
    x, w = gauss(32 + 12 * part.modes, 1.0)
    slopes = part.shapes.slopes((stations[:, None] * x).ravel())
    slopes = slopes.reshape(len(stations), len(x), part.modes)
    weights = stations[:, None] * w
    return np.asarray(np.einsum('kg,kgi,kgj->kij', weights, slopes, slopes))


def bending_stiffness(part: Deformation, length: float) -> Array:
    """EI times the integral of s'' s''^T: (m, m)."""
    x, w = gauss(32 + 12 * part.modes, length)
    bends = part.shapes.curvatures(x)
    return np.asarray(part.stiffness * np.einsum('g,gi,gj->ij', w, bends, bends))


def torsion_stiffness(part: Deformation, length: float) -> Array:
    """GJ times the integral of s' s'^T: (m, m)."""
    return np.asarray(part.stiffness * slope_squares(part, np.array([length]))[0])


def homogeneous(R: Jet, p: Jet) -> Jet:
    """(4, 4) series of a rotation (3, 3) and a position (3,)."""
    c = np.zeros((*R.c.shape[:2], 4, 4), np.result_type(R.c, p.c))
    c[..., :3, :3], c[..., :3, 3] = R.c, p.c
    c[0, 0, 3, 3] = 1
    return Jet(c)


class Oracle:
    """The verbs of a robot, dense."""

    def __init__(
        self,
        tree: Tree,
        gravity: tuple[float, float, float] = (0.0, 0.0, -9.81),
        geometric_stiffness: bool = True,
    ) -> None:
        self.tree = tree
        self.gravity = np.array(gravity)
        self.geometric_stiffness = geometric_stiffness
        self.spans: list[Span] = []
        self.n = 0
        for body in tree.bodies:
            self.spans.append(self._span(body))
        self.samples = [self._sample(body) for body in tree.bodies]
        self.stiffness = self._stiffness()
        self._integrals: dict[tuple[int, str, bytes], Array] = {}

    def _take(self, count: int) -> slice:
        self.n += count
        return slice(self.n - count, self.n)

    def _span(self, body: Body) -> Span:
        moves = body.joint is not None and body.joint.kind is not JointKind.FIXED
        modes = body.beam.modes if body.beam else (0, 0, 0)
        return Span(
            self._take(int(moves)),
            self._take(modes[0]),
            self._take(modes[1]),
            self._take(modes[2]),
        )

    def _sample(self, body: Body) -> Samples:
        mass, rigid = homogeneous_points(body.inertia)
        if body.beam is None:
            return Samples(mass, np.zeros(0), np.zeros(0), rigid)
        x, w = gauss(32 + 12 * max(body.beam.modes), body.beam.length)
        return Samples(np.concatenate([body.beam.mass_per_length * w, mass]), x, w, rigid)

    def _stiffness(self) -> Array:
        K = np.zeros((self.n, self.n))
        for body, span in zip(self.tree.bodies, self.spans, strict=True):
            if body.beam is None:
                continue
            for part, where in ((body.beam.y, span.y), (body.beam.z, span.z)):
                if part is not None:
                    K[where, where] = bending_stiffness(part, body.beam.length)
            if body.beam.torsion is not None:
                part = body.beam.torsion
                K[span.torsion, span.torsion] = torsion_stiffness(part, body.beam.length)
        return K

    def _series(self, q: Array, qd: Array, qdd: Array) -> Jet:
        """Coordinates along the motion, perturbed by e_k (k < n) and by t e_k (n <= k < 2 n)."""
        n = self.n
        c = np.zeros((3, 1 + 2 * n, n), np.result_type(q, qd, qdd, float))
        c[0, 0], c[1, 0], c[2, 0] = q, qd, np.asarray(qdd) / 2
        c[0, 1 : 1 + n] = c[1, 1 + n :] = np.eye(n)
        return Jet(c)

    def _foreshortening(self, i: int, axis: str, d: Jet, stations: Array) -> Jet:
        """-1/2 of the integral of the slope's square, at each station: (k,)."""
        part: Deformation = getattr(self.tree.bodies[i].beam, axis)
        key = (i, axis, stations.tobytes())
        if key not in self._integrals:
            self._integrals[key] = slope_squares(part, stations)
        H: Array = self._integrals[key].reshape(len(stations), -1)
        square = Jet(d.c[..., :, None]) @ Jet(d.c[..., None, :])
        flat = Jet(square.c.reshape(*square.c.shape[:2], -1))
        energy: Jet = flat @ H.T
        return energy * -0.5

    def _centre_line(self, i: int, series: Jet, stations: Array) -> Jet:
        """Positions of the beam's points in the body frame: (3, k)."""
        beam, span = self.tree.bodies[i].beam, self.spans[i]
        zero = Jet.constant(np.zeros(len(stations)), 2 * self.n)
        u = [zero + stations, zero, zero]
        for row, axis in ((1, 'y'), (2, 'z')):
            part, d = getattr(beam, axis), series[getattr(span, axis)]
            if part is None:
                continue
            u[row] = d @ part.shapes.values(stations).T
            if self.geometric_stiffness:
                u[0] = u[0] + self._foreshortening(i, axis, d, stations)
        return stack(u)

    def _section(self, i: int, series: Jet, station: float) -> Jet:
        """Transform (4, 4) of the cross-section at a station, seen from the body frame."""
        beam, span = self.tree.bodies[i].beam, self.spans[i]
        if beam is None or station == 0:
            return Jet.constant(np.eye(4), 2 * self.n)
        x = np.array([station])
        turn = [Jet.constant(np.zeros(()), 2 * self.n) for _ in range(3)]
        if beam.torsion is not None:
            turn[0] = series[span.torsion] @ beam.torsion.shapes.values(x)[0]
        if beam.z is not None:
            turn[1] = -(series[span.z] @ beam.z.shapes.slopes(x)[0])
        if beam.y is not None:
            turn[2] = series[span.y] @ beam.y.shapes.slopes(x)[0]
        return homogeneous(rotation(stack(turn)), self._centre_line(i, series, x)[:, 0])

    def _attached(self, attachment: Attachment, series: Jet, poses: list[Jet]) -> Jet:
        if attachment.body < 0:
            return Jet.constant(attachment.placement, 2 * self.n)
        section = self._section(attachment.body, series, attachment.station)
        return poses[attachment.body] @ section @ attachment.placement

    def _joint(self, i: int, series: Jet) -> Jet:
        joint = self.tree.bodies[i].joint
        if joint is None or joint.kind is JointKind.FIXED:
            return Jet.constant(np.eye(4), 2 * self.n)
        q = series[self.spans[i].joint]
        along = stack([q[0] * value for value in joint.axis])
        still = Jet.constant(np.zeros(3), 2 * self.n)
        if joint.kind is JointKind.PRISMATIC:
            return homogeneous(rotation(still), along)
        k = joint.axis  # Rodrigues' formula: the angle may be of any size
        K = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
        s, c = (f(q[0])[None, None] * np.ones((3, 3)) for f in (sin, cos))
        return homogeneous(s * K + (c * -1.0 + 1.0) * (K @ K) + np.eye(3), still)

    def poses(self, series: Jet) -> list[Jet]:
        """Transforms (4, 4) of the body frames in the base frame."""
        poses: list[Jet] = []
        for i, body in enumerate(self.tree.bodies):
            carried = self._attached(body.attachment, series, poses)
            poses.append(carried @ self._joint(i, series) @ body.frame)
        return poses

    def _local_points(self, i: int, series: Jet) -> Jet:
        """Homogeneous points of a body in its frame: (4, k), the beam's first."""
        samples = self.samples[i]
        rigid = Jet.constant(samples.rigid, 2 * self.n)
        if not len(samples.station):
            return rigid
        line = self._centre_line(i, series, samples.station)
        ones = Jet.constant(np.ones((1, len(samples.station))), 2 * self.n)
        top = np.concatenate([line.c, ones.c], axis=2)
        return Jet(np.concatenate([top, rigid.c], axis=3))

    def _spin(self, i: int, pose: Jet, series: Jet) -> tuple[Jet, Array]:
        """Total spin omega_x + beta' at the Gauss stations and its weights [kg m^2]."""
        beam = self.tree.bodies[i].beam
        assert beam is not None
        assert beam.torsion is not None
        samples, R = self.samples[i], pose[:3, :3]
        rate = (R.transpose() @ R.derivative())[2, 1]
        twist = series[self.spans[i].torsion] @ beam.torsion.shapes.values(samples.station).T
        spin = rate[None] * np.ones(len(samples.station)) + twist.derivative()
        return spin, beam.polar_inertia * samples.weight

    def _spinning(self) -> list[int]:
        beams: list[Beam | None] = [body.beam for body in self.tree.bodies]
        return [i for i, beam in enumerate(beams) if beam is not None and beam.torsion is not None]

    def joint_terms(self, name: str) -> Array:
        """A number of each joint (damping, friction, armature) on its coordinate: (n,)."""
        values = np.zeros(self.n)
        for body, span in zip(self.tree.bodies, self.spans, strict=True):
            if body.joint is not None:
                values[span.joint] = getattr(body.joint, name)
        return values

    def damping(self) -> Array:
        """Viscous coefficients of joints and amplitudes: (n,)."""
        values = self.joint_terms('damping')
        for body, span in zip(self.tree.bodies, self.spans, strict=True):
            if body.beam is not None:
                for axis in ('y', 'z', 'torsion'):
                    part = getattr(body.beam, axis)
                    if part is not None:
                        values[getattr(span, axis)] = part.damping
        return values

    def inverse_dynamics(
        self, q: Array, qd: Array, qdd: Array, wrenches: Mapping[str, Array] | None = None
    ) -> Array:
        """I qdd + h: Lagrange's equations, term by term."""
        n, series = self.n, self._series(q, qd, qdd)
        poses = self.poses(series)
        tau = self.stiffness @ q + self.damping() * qd + self.joint_terms('armature') * qdd
        tau = tau + self.joint_terms('friction') * np.tanh(np.asarray(qd) / SLIDE_SPEED)
        for i, pose in enumerate(poses):
            local = self._local_points(i, series)
            world = pose[:3, :] @ local
            pull = world.acceleration - np.outer(self.gravity, local.value[3])
            tau += np.einsum('k,nik,ik->n', self.samples[i].mass, world.c[0, 1 : 1 + n], pull)
        for i in self._spinning():
            y, weight = self._spin(i, poses[i], series)
            by_rate = y.c[0, 1 + n :]
            lagrange = y.c[1, 1 + n :] - 2 * y.c[0, 1 : 1 + n]
            tau += (by_rate * y.rate + lagrange * y.value) @ weight
        for frame, wrench in (wrenches or {}).items():
            tau -= self.frame_jacobian(frame, q).T @ wrench
        return np.asarray(tau)

    def bias_forces(self, q: Array, qd: Array) -> Array:
        """h(q, qd)."""
        return self.inverse_dynamics(q, qd, np.zeros(self.n))

    def inertia_matrix(self, q: Array) -> Array:
        """I(q) from the kinetic energy's squares."""
        n, zero = self.n, np.zeros(self.n)
        series = self._series(q, zero, zero)
        poses = self.poses(series)
        total = np.diag(self.joint_terms('armature'))
        for i, pose in enumerate(poses):
            J = (pose[:3, :] @ self._local_points(i, series)).c[0, 1 : 1 + n]
            total += np.einsum('k,aik,bik->ab', self.samples[i].mass, J, J)
        for i in self._spinning():
            y, weight = self._spin(i, poses[i], series)
            total += (y.c[0, 1 + n :] * weight) @ y.c[0, 1 + n :].T
        return np.asarray(total)

    def energy(self, q: Array, qd: Array) -> tuple[float, float]:
        """Kinetic and potential energy [J]."""
        series = self._series(q, qd, np.zeros(self.n))
        poses = self.poses(series)
        kinetic = self.joint_terms('armature') @ np.square(qd) / 2
        potential = q @ self.stiffness @ q / 2
        for i, pose in enumerate(poses):
            local, mass = self._local_points(i, series), self.samples[i].mass
            world = pose[:3, :] @ local
            kinetic += (mass * world.rate**2).sum() / 2
            potential -= mass * local.value[3] @ (self.gravity @ world.value)
        for i in self._spinning():
            y, weight = self._spin(i, poses[i], series)
            kinetic += weight @ y.value**2 / 2
        return float(kinetic), float(potential)

    def forward_dynamics(self, q: Array, qd: Array, tau: Array) -> Array:
        """Accelerations by a dense solve."""
        return np.asarray(np.linalg.solve(self.inertia_matrix(q), tau - self.bias_forces(q, qd)))

    def frame_pose(self, frame: str, q: Array) -> Array:
        """(4, 4) pose of a frame in the base frame."""
        return self._frame(frame, q).value

    def _frame(self, frame: str, q: Array) -> Jet:
        series = self._series(q, np.zeros(self.n), np.zeros(self.n))
        return self._attached(self.tree.frames[frame], series, self.poses(series))

    def frame_jacobian(self, frame: str, q: Array) -> Array:
        """(6, n), linear first, world axes."""
        pose = self._frame(frame, q)
        turn = pose.c[0, 1 : 1 + self.n, :3, :3] @ pose.value[:3, :3].T
        linear = pose.c[0, 1 : 1 + self.n, :3, 3]
        angular = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
        return np.asarray(np.concatenate([linear, angular], axis=1).T)

    def deflection(self, link: str, q: Array, station: float) -> Array:
        """(3,) deflection of a link's beam at a station, beam frame."""
        i = [body.name for body in self.tree.bodies].index(link)
        series = self._series(q, np.zeros(self.n), np.zeros(self.n))
        line = self._centre_line(i, series, np.array([station]))
        return np.asarray(line.value[:, 0] - [station, 0, 0])

    def amplitudes(self, i: int) -> NDArray[np.int_]:
        """Indices of a body's amplitudes among the n."""
        span = self.spans[i]
        return np.asarray(np.r_[span.y, span.z, span.torsion], dtype=int)

    def twists(self, q: Array, qd: Array) -> Array:
        """Stacked t_i = [v; omega; ddot; cdot] in body frames."""
        rows = []
        for i, pose in enumerate(self.poses(self._series(q, qd, np.zeros(self.n)))):
            R, dR = pose.value[:3, :3], pose.rate[:3, :3]
            W = R.T @ dR
            rows += [R.T @ pose.rate[:3, 3], [W[2, 1], W[0, 2], W[1, 0]], qd[self.amplitudes(i)]]
        return np.concatenate(rows)

    def mass_matrices(self, q: Array) -> list[Array]:
        """Each body's (6 + m, 6 + m) mass matrix about its frame."""
        zero = np.zeros(self.n)
        series = self._series(q, zero, zero)
        return [
            self._mass_matrix(i, self._local_points(i, series)) for i in range(len(self.spans))
        ]

    def _mass_matrix(self, i: int, local: Jet) -> Array:
        own, p = self.amplitudes(i), local.value
        G = np.zeros((6 + len(own), 3, p.shape[1]))
        for axis in range(3):
            unit = np.eye(3)[axis]
            G[axis] = np.outer(unit, p[3])
            G[3 + axis] = np.cross(unit, p[:3], axisb=0).T
        G[6:] = local.c[0, 1 + own, :3]
        M = np.einsum('k,aik,bik->ab', self.samples[i].mass, G, G)
        beam = self.tree.bodies[i].beam
        if beam is not None and beam.torsion is not None:
            g = np.zeros((6 + len(own), len(self.samples[i].station)))
            g[3] = 1
            g[-beam.torsion.modes :] = beam.torsion.shapes.values(self.samples[i].station).T
            M += (g * (beam.polar_inertia * self.samples[i].weight)) @ g.T
        return np.asarray(M)
