"""A robot as MuJoCo's model: each beam a chain of rigid rods on sprung hinges.

A beam of length l is N + 1 rods with a hinge per deformation between neighbours. A hinge stands
for the curvature of a cell of length h: its angle is the curvature where it stands times h, so a
chain's flexibility is a quadrature of the beam's, int M(x) m(x) / EI dx. Hinges therefore stand at
the points of Gauss' rule, two in each of N / 2 panels of length 2 h, each with a spring

    K = EI / h.

The rule is exact for cubics: force, moment and distributed load bend and turn the chain's tip
exactly as they do the beam's, and natural frequencies converge with h^4. Torsion, whose
frequencies converge with h^2, has the same points. Large deflections and foreshortening are those
of the chain's geometry, so that nothing of the shape functions is left in it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from lxml import etree
from scipy.spatial.transform import Rotation

from denoc_ros.errors import ModelError
from denoc_ros.export.mjcf_visuals import add_rod, add_visuals
from denoc_ros.model.arrays import is_flexible
from denoc_ros.model.beams.segments import deformations
from denoc_ros.model.inertia import beam_inertia, moved, total
from denoc_ros.model.reading.findings import Element, Findings
from denoc_ros.model.reading.poses import pose_of
from denoc_ros.model.tree import (
    Attachment,
    Beam,
    Body,
    Deformation,
    Joint,
    JointKind,
    Limits,
    Loop,
    RigidInertia,
    Sensor,
    Tree,
)
from denoc_ros.types import Array

SEGMENTS = 16
MOST_SEGMENTS = 200
INERTIAL_TAGS = {'gyro': 'gyro', 'accel': 'accelerometer'}
AXES = {'y': '0 0 1', 'z': '0 -1 0', 't': '1 0 0'}  # of the hinge of each deformation
# MuJoCo wants a mass and principal moments above 1e-15 of whatever moves
LEAST_MASS, LEAST_INERTIA = 1e-12, 1e-12
ROUNDED, DOUBTFUL = 1e-10, 1e-6  # of the largest moment: A + B >= C missed by rounding
LONGEST_STEP = 1e-3  # s
STEP_SHARE = 0.2  # of a cell's time h^2 / sqrt(EI / rho A): Runge-Kutta steps are stable below 0.4
FASTEST = 5.0  # over a chain's own time: bound of its natural frequencies [rad/s]
ARM = 1.0  # m, between the two points on the axis of a loop's revolute joint


@dataclass(frozen=True)
class ChainedDeformation:
    """The hinges that stand for one deformation of a beam, or of a segment of one."""

    coordinates: tuple[str, ...]  # names of the model's amplitudes of it
    hinges: tuple[str, ...]
    amplitudes: Array  # (modes, hinges) amplitude per hinge angle, by projection
    angles: Array  # (modes, hinges) hinge angle per amplitude


@dataclass(frozen=True)
class Mjcf:
    """A model for MuJoCo."""

    # the file. Bodies and joints have the names of the description; a site has the name of each
    # link's and loop's frame and stands where it does; rods are `link/rod1`, ..., their hinges
    # `link/rod1/y`, `/z` and `/t`; `link/tip` is the site of a beam's tip.
    text: str
    notes: tuple[str, ...]  # where it means something else than the description
    deformations: tuple[ChainedDeformation, ...] = ()


@dataclass(frozen=True)
class _Chain:
    """The hinges of one beam, or of one of its segments."""

    beam: Beam
    hinges: int

    @cached_property
    def rule(self) -> tuple[Array, Array]:
        """Stations of the hinges and lengths of their cells (hinges,) [m].

        Two hinges a panel; of an odd number three in the first panel, or one at all.
        """
        cell, odd = self.beam.length / self.hinges, self.hinges % 2
        counts = [1 if self.hinges == 1 else 3] if odd else []
        counts += [2] * ((self.hinges - sum(counts)) // 2)
        stations, cells, begin = [], [], 0.0
        for count in counts:
            points, weights = np.polynomial.legendre.leggauss(count)
            half = 0.5 * count * cell
            stations.append(begin + half * (1.0 + points))
            cells.append(half * weights)
            begin += 2.0 * half
        return np.concatenate(stations), np.concatenate(cells)

    @property
    def stations(self) -> Array:
        """Stations of the hinges (hinges,) [m]."""
        return self.rule[0]

    @property
    def starts(self) -> Array:
        """Stations at which the rods begin (hinges + 1,) [m]."""
        return np.concatenate([[0.0], self.stations])

    @property
    def parts(self) -> dict[str, Deformation]:
        """Deformations of the beam, by the names of `AXES`."""
        all_ = {'y': self.beam.y, 'z': self.beam.z, 't': self.beam.torsion}
        return {name: part for name, part in all_.items() if part is not None and part.modes}

    def stiffness(self, name: str) -> Array:
        """Springs of the hinges (hinges,) [N m/rad].

        A single one makes the tip's deflection under a force there exact.
        """
        share = 0.75 if self.hinges == 1 and name != 't' else 1.0
        at = self.parts[name].stiffness_at(self.stations / self.beam.length)
        return np.asarray(share * at / self.rule[1])

    def own_time(self, name: str) -> float:
        """Time [s] of waves along the shortest rod between hinges; no mode exceeds 5 / it."""
        part, shortest = (
            self.parts[name],
            float(np.diff(self.stations).min(initial=self.beam.length / self.hinges)),
        )
        share = self.stations / self.beam.length
        if name == 't':
            inertia = self.beam.polar_inertia * self.beam.polar_along.values(share)
            return shortest * math.sqrt(float(np.min(inertia / part.stiffness_at(share))))
        inertia = self.beam.mass_per_length * self.beam.mass_along.values(share)
        return shortest**2 * math.sqrt(float(np.min(inertia / part.stiffness_at(share))))

    def proportional(self, name: str) -> float:
        """Damping per stiffness [s] that all hinges have.

        That of the model's least damped mode, but the fastest of the chain is damped by half of
        the critical at most: explicit steps would not be stable for long.
        """
        part = self.parts[name]
        least = float(np.min(part.damping / part.modal_stiffness))
        return min(least, self.own_time(name) / FASTEST)

    def rod(self, index: int) -> RigidInertia:
        """Inertia of a rod about its start.

        A rod that is shorter than its section is wide has the rotary inertia of its sections,
        without which it would be no real body.
        """
        starts = np.append(self.starts, self.beam.length)
        length = float(starts[index + 1] - starts[index])
        begin, end = starts[index] / self.beam.length, starts[index + 1] / self.beam.length
        part = self.beam.mass_along.part(begin, end)
        slender = beam_inertia(self.beam.mass_per_length, length, 0.0, part)
        mass, centre = slender.mass, slender.first_moment[0] / slender.mass
        about = self.beam.polar_inertia * length * self.beam.polar_along.part(begin, end).moment(0)
        own = slender.inertia[1, 1] - mass * centre**2
        across = mass * centre**2 + max(own, 0.5 * about)
        first = slender.first_moment
        return RigidInertia(mass, first, np.diag([about, across, across]))

    @property
    def is_wide(self) -> bool:
        """Whether its rods need rotary inertia."""
        shortest = float(np.diff(np.append(self.starts, self.beam.length)).min())
        share = self.stations / self.beam.length
        polar = self.beam.polar_inertia * self.beam.polar_along.values(share)
        mass = self.beam.mass_per_length * self.beam.mass_along.values(share)
        return bool(np.any(6.0 * polar > mass * shortest**2))

    def amplitudes(self, name: str) -> Array:
        """Amplitudes (modes, hinges) per hinge angle: those of the strain energy's projection."""
        part = self.parts[name]
        at = part.stiffness_at(self.stations / self.beam.length)[:, None]
        return np.asarray((self.strain(name) * at / part.modal_stiffness).T)

    def strain(self, name: str) -> Array:
        """Curvature, or twist per length, (hinges, modes) at the hinges per amplitude."""
        shapes = self.parts[name].shapes
        return np.asarray(shapes.derivatives(self.stations, 1 if name == 't' else 2))


@dataclass
class _Hinge:
    """A hinge of a link's beam."""

    name: str
    station: float  # on the link's whole beam [m]
    strain: float  # curvature of the beam there per angle [1/m]


@dataclass
class _Writer:
    tree: Tree
    segments: int
    findings: Findings
    notes: list[str] = field(default_factory=list)
    chains: dict[int, _Chain] = field(default_factory=dict)  # by body
    rods: dict[int, list[Element]] = field(default_factory=dict)  # elements of each body's rods
    hinges: dict[tuple[str, str], list[_Hinge]] = field(default_factory=dict)  # by link, direction
    step: float = LONGEST_STEP
    deformations: list[ChainedDeformation] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.root = etree.Element('mujoco', model=self.tree.name)
        etree.SubElement(
            self.root,
            'compiler',
            {'angle': 'radian', 'inertiafromgeom': 'false', 'autolimits': 'false'},
        )
        self.option = etree.SubElement(self.root, 'option', integrator='RK4')
        self.asset = etree.SubElement(self.root, 'asset')
        self.world = etree.SubElement(self.root, 'worldbody')
        self.tendon, self.equality, self.actuator, self.sensor = (
            etree.SubElement(self.root, tag)
            for tag in ('tendon', 'equality', 'actuator', 'sensor')
        )

    def place(self, at: Attachment) -> tuple[Element, Array]:
        """Return the element that carries an attachment, and its pose (4, 4) there."""
        if at.body < 0:
            return self.world, at.placement
        pose: Array = at.placement.copy()
        rods = self.rods[at.body]
        if len(rods) == 1 or at.station == 0.0:
            pose[0, 3] += at.station
            return rods[0], pose
        chain = self.chains[at.body]
        index = min(int(np.searchsorted(chain.stations, at.station)), chain.hinges)
        pose[0, 3] += at.station - chain.starts[index]
        return rods[index], pose

    def site(self, name: str, at: Attachment, along: Array | None = None) -> None:
        """Add a site at an attachment, or `ARM` along an axis of it."""
        carrier, pose = self.place(at)
        if along is not None:
            pose = pose.copy()
            pose[:3, 3] += ARM * pose[:3, :3] @ along
        etree.SubElement(carrier, 'site', name=name, **_pose(pose), size='0.005', group='4')

    def body(self, index: int, body: Body) -> None:
        """Add a body, of a flexible one all rods."""
        carrier, pose = self.place(body.attachment)
        element = etree.SubElement(carrier, 'body', name=body.name, **_pose(pose @ body.frame))
        self.rods[index] = [element]
        if body.floating:
            etree.SubElement(element, 'freejoint', name=body.floating)
        elif body.joint is not None and body.joint.kind is not JointKind.FIXED:
            self.joint(element, body.joint, body.frame)
        inertia = body.inertia
        if is_flexible(body):
            assert body.beam is not None
            hinges = _hinges(self.segments, body.beam.segments)
            self.chains[index] = _Chain(body.beam, hinges)
            self.chain(index, body)
            inertia = total(inertia, self.chains[index].rod(0))
        elif body.beam is not None:
            inertia = total(inertia, _Chain(body.beam, 1).rod(0))
            inertia = total(inertia, _shifted(_Chain(body.beam, 1).rod(1), body.beam.length / 2))
        self.inertial(element, inertia, f'link {body.name!r}')

    def joint(self, element: Element, joint: Joint, frame: Array) -> None:
        """Add a joint, of an elastic one its motor and its spring, and its actuator."""
        rotation = frame[:3, :3].T
        spot = {
            'type': 'slide' if joint.kind is JointKind.PRISMATIC else 'hinge',
            'pos': _text(-rotation @ frame[:3, 3]),
            'axis': _text(rotation @ joint.axis),
        }
        own = {'damping': joint.damping, 'frictionloss': joint.friction}
        numbers = {name: _text(value) for name, value in own.items() if value}
        if joint.armature:
            numbers['armature'] = _text(joint.armature)
        numbers.update(_range(joint.limits))
        etree.SubElement(element, 'joint', name=joint.name, **spot, **numbers)
        if joint.spring is not None:
            self.spring(element, joint, spot)
        if joint.mimic is None:
            effort = joint.limits.effort
            limits = {}
            if 0.0 < effort < math.inf:
                limits = {'ctrllimited': 'true', 'ctrlrange': _text(-effort, effort)}
            etree.SubElement(self.actuator, 'motor', name=joint.name, joint=joint.name, **limits)

    def spring(self, element: Element, joint: Joint, spot: Mapping[str, str]) -> None:
        """Add the hinge between the motor side of an elastic joint and its link side."""
        spring = joint.spring
        assert spring is not None
        if spring.backlash:
            rule = 'backlash must be 0 in MJCF, which has no free play'
            self.findings.add(
                f'spring of joint {joint.name!r}', f'{rule}, got {spring.backlash:g}'
            )
        cubic = (0.0, spring.stiffness3) if spring.stiffness3 else ()
        etree.SubElement(
            element,
            'joint',
            name=f'{joint.name}/spring',
            **spot,
            stiffness=_text(spring.stiffness, *cubic),
            damping=_text(spring.damping),
        )
        if joint.armature:
            self.limit_step(math.sqrt(joint.armature / spring.stiffness))

    def chain(self, index: int, body: Body) -> None:
        """Add the rods of a beam after the first, their hinges and their damping."""
        chain, element = self.chains[index], self.rods[index][0]
        names = {name: list[str]() for name in chain.parts}
        ends = np.append(chain.stations, chain.beam.length)
        add_rod(element, chain.beam, float(chain.starts[1]))
        for k, start in enumerate(chain.starts[1:], 1):
            gap = float(start - chain.starts[k - 1])
            rod = f'{body.name}/rod{k}'
            element = etree.SubElement(element, 'body', name=rod, pos=_text(gap, 0.0, 0.0))
            self.rods[index].append(element)
            for name in chain.parts:
                names[name].append(f'{rod}/{name}')
                self.hinge(element, f'{rod}/{name}', name, chain, k - 1)
                at = body.start + float(start)
                strain = float(1.0 / chain.rule[1][k - 1])
                listed = self.hinges.setdefault((body.link, name), [])
                listed.append(_Hinge(f'{rod}/{name}', at, strain))
            self.inertial(element, chain.rod(k), rod)
            add_rod(element, chain.beam, float(ends[k] - start))
        for name, part in chain.parts.items():
            self.modal_damping(body.name, name, part, chain, names[name])
            self.deformations.append(
                ChainedDeformation(
                    tuple(f'{body.name}/{name}{mode + 1}' for mode in range(part.modes)),
                    tuple(names[name]),
                    chain.amplitudes(name),
                    chain.strain(name).T * chain.rule[1],
                )
            )
            self.limit_step(chain.own_time(name))

    def hinge(self, element: Element, name: str, kind: str, chain: _Chain, at: int) -> None:
        """Add the hinge of one deformation, damped in proportion to its stiffness."""
        stiffness = chain.stiffness(kind)[at]
        numbers = {'stiffness': _text(stiffness)}
        if time := chain.proportional(kind):
            numbers['damping'] = _text(time * stiffness)
        etree.SubElement(element, 'joint', name=name, type='hinge', axis=AXES[kind], **numbers)

    def modal_damping(
        self, body: str, kind: str, part: Deformation, chain: _Chain, names: list[str]
    ) -> None:
        """Add the damping of modes that hinges damped alike do not have, as tendons."""
        rest = part.damping - chain.proportional(kind) * part.modal_stiffness
        for mode, (share, row) in enumerate(zip(rest, chain.amplitudes(kind), strict=True), 1):
            if share > ROUNDED * part.damping[mode - 1]:
                self.fixed(f'{body}/{kind}{mode}', dict(zip(names, row, strict=True)), share)

    def fixed(self, name: str, coefficients: Mapping[str, float], damping: float = 0.0) -> None:
        """Add a sum of hinge angles; its damping acts on each by its coefficient."""
        numbers = {'damping': _text(damping)} if damping else {}
        tendon = etree.SubElement(self.tendon, 'fixed', name=name, **numbers)
        for joint, coefficient in coefficients.items():
            etree.SubElement(tendon, 'joint', joint=joint, coef=_text(coefficient))

    def inertial(self, element: Element, inertia: RigidInertia, whose: str) -> None:
        """Add a body's inertia; note one that no real body has."""
        mass, centre = max(inertia.mass, LEAST_MASS), np.zeros(3)
        if inertia.mass > 0.0:
            centre = inertia.first_moment / inertia.mass
        about = inertia.inertia - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
        about = 0.5 * (about + about.T)
        small, middle, large = np.linalg.eigvalsh(about)
        lack = max(large - small - middle, -small)
        if lack > DOUBTFUL * abs(large) + LEAST_INERTIA or inertia.mass < 0.0:
            shown = ', '.join(f'{value:.4g}' for value in (small, middle, large))
            rule = 'inertia must be that of a real body in MJCF (mass > 0, moments A + B >= C)'
            self.findings.add(whose, f'{rule}, got mass {inertia.mass:g}, moments {shown}')
        about += (max(lack, 0.0) + ROUNDED * abs(large) + LEAST_INERTIA) * np.eye(3)
        upper = about[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        inertial = {'pos': _text(*centre), 'mass': _text(mass), 'fullinertia': _text(*upper)}
        element.insert(0, etree.Element('inertial', inertial))

    def limit_step(self, time: float) -> None:
        """Keep the time step below a share of a part's own time [s]."""
        self.step = min(self.step, STEP_SHARE * time)

    def loop(self, loop: Loop) -> None:
        """Add the equality constraints of a loop."""
        whose = f'loop {loop.name!r}'
        if loop.type not in ('revolute', 'spherical', 'fixed'):
            rule = 'type must be revolute, spherical or fixed in MJCF'
            self.findings.add(whose, f'{rule}, got {loop.type}')
        if loop.damping or loop.friction:
            rule = 'damping and friction must be 0 in MJCF, whose constraints have none'
            self.findings.add(whose, f'{rule}, got {loop.damping:g} and {loop.friction:g}')
        sides = [loop.parent.frame, loop.child.frame]
        kind = 'weld' if loop.type == 'fixed' else 'connect'
        self.equal(kind, loop.name, sides)
        if loop.type == 'revolute':
            for side in sides:
                self.site(f'{side}/axis', self.tree.frames[side], loop.axis)
            self.equal(kind, f'{loop.name}/axis', [f'{side}/axis' for side in sides])

    def equal(self, kind: str, name: str, sites: list[str]) -> None:
        """Add an equality constraint of two sites."""
        etree.SubElement(self.equality, kind, name=name, site1=sites[0], site2=sites[1])

    def mimics(self) -> None:
        """Add the mimic joints' constraints."""
        for name, mimic in self.tree.mimics.items():
            etree.SubElement(
                self.equality, 'joint', name=name, joint1=name, joint2=mimic.leader,
                polycoef=_text(mimic.offset, mimic.multiplier, 0.0, 0.0, 0.0),
            )  # fmt: skip

    def gauge(self, sensor: Sensor) -> None:
        """Add a sensor on a beam: a sum of hinge angles and its position."""
        listed = self.hinges[sensor.link, sensor.direction]
        body = self.tree.bodies[sensor.body]
        assert body.beam is not None
        scale = _reading(sensor, body.beam.bending(sensor.direction))
        if sensor.quantity == 'deflection':
            arms = [(hinge, sensor.station - hinge.station) for hinge in listed]
            coefficients = {hinge.name: arm for hinge, arm in arms if arm > 0.0}
        else:
            slope = sensor.quantity == 'shear'
            coefficients = dict(_interpolated(listed, sensor.station, slope))
        scaled = {name: scale * value for name, value in coefficients.items()}
        self.fixed(f'sensor/{sensor.name}', scaled or {listed[0].name: 0.0})
        noise = {'noise': _text(sensor.noise)} if sensor.noise else {}
        etree.SubElement(
            self.sensor, 'tendonpos', name=sensor.name, tendon=f'sensor/{sensor.name}', **noise
        )

    def inertial_sensors(self) -> None:
        """Add gyroscopes and accelerometers."""
        for sensor in self.tree.inertial_sensors:
            self.site(sensor.frame, sensor.mount)
            for vector in sensor.kind.vectors:
                noise = _text(getattr(sensor, f'{vector}_noise'))
                etree.SubElement(
                    self.sensor, INERTIAL_TAGS[vector], site=sensor.frame, noise=noise,
                    name=f'{sensor.name}/{INERTIAL_TAGS[vector]}',
                )  # fmt: skip


def mjcf(tree: Tree, gravity: Array, segments: int = SEGMENTS, folder: Path | None = None) -> Mjcf:
    """Return a robot as MuJoCo's model.

    Parameters
    ----------
    gravity : ndarray (3,)
        In the base frame [m/s^2].
    segments : int
        Number N of cells of each flexible link, 1 to 200.

    Raises
    ------
    ModelError
        With everything that MJCF cannot hold, by its name.
    """
    findings = Findings()
    if not 1 <= segments <= MOST_SEGMENTS:
        findings.add('segments', f'must be 1 to {MOST_SEGMENTS}, got {segments}')
        ModelError.raise_any(tree.name, findings.items)
    for body in tree.bodies:
        if body.modes is not None:
            rule = 'must be a <beam>, which MJCF holds as a chain of hinges'
            findings.add(f'link {body.name!r}', f'{rule}, got a <flexible>')
    ModelError.raise_any(tree.name, findings.items)
    writer = _Writer(tree, segments, findings)
    for index, body in enumerate(tree.bodies):
        writer.body(index, body)
    for name, at in tree.frames.items():
        writer.site(name, at)
    for index, body in enumerate(tree.bodies):
        if index in writer.chains and body.beam is not None and body.segment == body.beam.segments:
            writer.site(f'{body.link}/tip', Attachment(index, body.beam.length, np.eye(4)))
    for loop in tree.loops:
        writer.loop(loop)
    writer.mimics()
    for sensor in tree.sensors:
        writer.gauge(sensor)
    writer.inertial_sensors()
    places = {link: writer.place(at) for link, at in tree.frames.items()}
    flexible = {body.link for body in tree.bodies if is_flexible(body)}
    rigid = {link: at for link, at in places.items() if link not in flexible}
    writer.notes += add_visuals(tree.source, rigid, writer.asset, folder)
    ModelError.raise_any(tree.name, findings.items)
    _options(writer, gravity)
    notes = (*_notes(tree, writer.chains.values()), *writer.notes)
    return Mjcf(_written(writer.root), notes, tuple(writer.deformations))


def _options(writer: _Writer, gravity: Array) -> None:
    """Set the time step, gravity and how stiff constraints are."""
    power = 10.0 ** (math.floor(math.log10(writer.step)) - 1)
    step = math.floor(writer.step / power) * power
    writer.option.set('timestep', f'{step:.2g}')
    writer.option.set('gravity', _text(*gravity))
    for constraint in writer.equality:
        constraint.set('solref', f'{2.0 * step:.3g} 1')
        constraint.set('solimp', '0.999 0.9999 1e-6')


def _notes(tree: Tree, chains: Iterable[_Chain]) -> list[str]:
    """Return where MJCF means something else than the description."""
    notes = []
    joints = tree.joints.values()
    if any(joint.friction for joint in joints):
        notes.append('friction: MuJoCo holds a resting joint still, without a smooth slip')
    if any(0.0 < joint.limits.velocity < math.inf for joint in joints):
        notes.append('velocity limits: MJCF has none')
    beams = [body.beam for body in tree.bodies if body.beam is not None]
    if any(part.damping.any() for beam in beams for _, part, _ in deformations(beam)):
        rule = "modal damping: exact for the model's modes; the chain's higher modes are damped in"
        notes.append(f'{rule} proportion to stiffness, at most as its least damped mode')
    if any(chain.is_wide for chain in chains):
        notes.append('rotary inertia: rods shorter than their sections are wide have that of them')
    if any(sensor.gain != 1.0 or sensor.offset for sensor in tree.sensors):
        notes.append('gain and offset of sensors: sensordata has values in SI units')
    return notes


def _hinges(wanted: int, segments: int) -> int:
    """Return the number of hinges in each of a link's segments: two, or none is exact."""
    return wanted if segments == 1 else max(2, round(wanted / segments))


def _reading(sensor: Sensor, part: Deformation) -> float:
    """Return a sensor's value per curvature, per its slope or per deflection."""
    if sensor.quantity == 'deflection':
        return 1.0
    if sensor.quantity == 'strain':
        return -sensor.surface
    if sensor.quantity == 'moment' and sensor.direction == 'y':
        return -part.stiffness
    return part.stiffness


def _interpolated(
    hinges: list[_Hinge], station: float, slope: bool
) -> Iterator[tuple[str, float]]:
    """Yield hinges and weights that make up the curvature at a station, or its slope.

    The curvature is linear between the two hinges nearest to the station, and beyond the last: a
    force at the tip makes such a one.
    """
    if len(hinges) == 1:
        if not slope:
            yield hinges[0].name, hinges[0].strain
        return
    stations = [hinge.station for hinge in hinges]
    first = min(max(int(np.searchsorted(stations, station)) - 1, 0), len(hinges) - 2)
    one, two = hinges[first], hinges[first + 1]
    gap = two.station - one.station
    share = (station - one.station) / gap
    weights = (-1.0 / gap, 1.0 / gap) if slope else (1.0 - share, share)
    for hinge, weight in zip((one, two), weights, strict=True):
        yield hinge.name, weight * hinge.strain


def _shifted(inertia: RigidInertia, x: float) -> RigidInertia:
    return moved(inertia, pose_of((x, 0.0, 0.0)))


def _range(limits: Limits) -> dict[str, str]:
    """Return a joint's limits as attributes; MuJoCo wants both ends."""
    ends = np.array([limits.lower, limits.upper])
    if not np.isfinite(ends).any() or ends[0] >= ends[1]:
        return {}
    return {'limited': 'true', 'range': _text(*np.clip(ends, -1e6, 1e6))}


def _pose(pose: Array) -> dict[str, str]:
    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
    turned = {} if np.array_equal(pose[:3, :3], np.eye(3)) else {'quat': _text(w, x, y, z)}
    return {'pos': _text(*pose[:3, 3]), **turned}


def _text(*numbers: float | Array) -> str:
    """Return numbers in full."""
    return ' '.join(f'{float(number):.17g}' for part in numbers for number in np.ravel(part))


def _written(root: Element) -> str:
    for element in root.xpath('./*[not(node()) and not(@*)]'):
        root.remove(element)
    text: str = etree.tostring(root, encoding='unicode', pretty_print=True)
    return text
