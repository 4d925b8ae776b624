"""The robot model as an immutable tree of bodies, ready to be written to arrays.

Produced from URDF + `<flexibility>` by :mod:`denoc_ros.model.reading.urdf`; nothing here knows of
files.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np

from denoc_ros.model.beams.along import CONSTANT, Along
from denoc_ros.model.beams.link_file import ReducedLink
from denoc_ros.model.beams.shapes import ShapeFunctions
from denoc_ros.types import Array


class JointKind(Enum):
    """The kind of a joint."""

    FIXED = 0
    REVOLUTE = 1
    PRISMATIC = 2
    FLOATING = 3  # in a file only: a body that floats has `floating`

    @property
    def unit(self) -> str:
        """Unit of the joint's position: m or rad."""
        return 'm' if self is JointKind.PRISMATIC else 'rad'

    @property
    def effort_unit(self) -> str:
        """Unit of the joint's force or torque: N or N m."""
        return 'N' if self is JointKind.PRISMATIC else 'N m'

    @property
    def units(self) -> dict[str, str]:
        """Units of a joint's and its spring's numbers, by the names of their paths."""
        position, effort = self.unit, self.effort_unit
        return {
            'damping': f'{effort} s/{position}',
            'friction': effort,
            'armature': 'kg m^2' if position == 'rad' else 'kg',
            'stiffness': f'{effort}/{position}',
            'spring_damping': f'{effort} s/{position}',
            'stiffness3': f'{effort}/{position}^3',
            'backlash': position,
        }


@dataclass(frozen=True)
class Limits:
    """Limits of a joint; infinite where the file gives none."""

    lower: float = -np.inf  # rad or m
    upper: float = np.inf  # rad or m
    velocity: float = np.inf  # rad/s or m/s
    effort: float = np.inf  # N m or N


@dataclass(frozen=True)
class Mimic:
    """A mimic joint's constraint to its leader: q = multiplier * q_leader + offset."""

    leader: str
    multiplier: float
    offset: float


SIDES = ('motor', 'link')


@dataclass(frozen=True)
class Spring:
    """The elasticity between the motor side of a joint and its link side.

    With s = link side - motor side and the wind-up e(s), which is s but for the backlash, the
    spring's force is (stiffness e + stiffness3 e^3) de/ds + damping s'.
    """

    stiffness: float  # N m/rad or N/m
    damping: float = 0.0  # N m s/rad or N s/m
    stiffness3: float = 0.0  # N m/rad^3 or N/m^3
    backlash: float = 0.0  # rad or m: the whole free play
    measured: str = 'motor'  # which of SIDES joint states mean


@dataclass(frozen=True)
class Joint:
    """The joint before a body."""

    name: str
    kind: JointKind
    axis: Array  # (3,) unit, in the joint frame
    limits: Limits = Limits()
    damping: float = 0.0  # N m s/rad or N s/m
    friction: float = 0.0  # N m or N
    armature: float = 0.0  # kg m^2 or kg
    mimic: Mimic | None = None
    continuous: bool = False
    spring: Spring | None = None  # None: the link turns with the motor

    @property
    def unit(self) -> str:
        """Unit of its position: m or rad."""
        return self.kind.unit

    @property
    def effort_unit(self) -> str:
        """Unit of its force or torque: N or N m."""
        return self.kind.effort_unit


@dataclass(frozen=True)
class RigidInertia:
    """Inertia of a rigid body about the origin of the frame it is given in."""

    mass: float = 0.0  # kg
    first_moment: Array = field(default_factory=lambda: np.zeros(3))  # (3,) mass * com [kg m]
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))  # (3, 3) about the origin


@dataclass(frozen=True)
class Payload:
    """A rigid payload: mass [kg], com (3,) [m], inertia (3, 3) [kg m^2] about it, link axes."""

    mass: float
    com: Array
    inertia: Array


@dataclass(frozen=True)
class Deformation:
    """One elastic deformation of a beam: bending in a direction, or torsion."""

    shapes: ShapeFunctions  # scaled to max |s| = 1, positive at the tip
    stiffness: float  # EI [N m^2] or GJ [N m^2]: the mean over the link's whole beam
    modal_stiffness: Array  # (m,) diagonal
    damping: Array  # (m,) coefficients [N s/m] or [N m s/rad]
    shape: str = ''  # name of the shapes
    along: Along = CONSTANT  # shares of the stiffness along this beam
    order: int = 2  # of the derivative that is the strain: 1 of torsion
    first_root: float | None = None  # omega L^order / sqrt(stiffness / inertia) of the link's
    # lowest mode, tip free; None of a uniform one
    damping_ratio: Array | None = None  # (m,) or (1,), None where damping is not given by it

    def stiffness_at(self, share: Array) -> Array:
        """Return EI or GJ [N m^2] at shares of the beam's length."""
        return np.asarray(self.stiffness * self.along.values(share))

    @property
    def unit_stiffness(self) -> Array:
        """Modal stiffness (m,) by EI or GJ."""
        return np.asarray(self.modal_stiffness / self.stiffness)

    def with_stiffness(self, stiffness: float) -> Deformation:
        """Return the same of another EI or GJ [N m^2], its damping as it was."""
        modal = stiffness * np.diag(self.shapes.gram(self.order, self.along))
        return replace(self, stiffness=stiffness, modal_stiffness=modal)

    @property
    def modes(self) -> int:
        """Number of shape functions."""
        return len(self.damping)


@dataclass(frozen=True)
class Beam:
    """The elastic part of a link: a slender beam along +X of the body frame, from x = 0."""

    length: float  # m
    mass_per_length: float  # kg/m, the mean over the link's whole beam
    polar_inertia: float = 0.0  # kg m^2/m, used where there is torsion; the mean like the mass
    y: Deformation | None = None  # bending with deflection along y
    z: Deformation | None = None  # bending with deflection along z
    torsion: Deformation | None = None
    segments: int = 1  # this beam is one of so many of one length that make up the link's
    mass_along: Along = CONSTANT  # shares of mass_per_length along this beam
    polar_along: Along = CONSTANT  # shares of polar_inertia along this beam
    strain_limit: float = np.inf  # of the outer fibre, for plans
    surface: tuple[float, float] = (0.0, 0.0)  # m, how far it is along y and z; 0: not known
    corners: bool = False  # whether strains of both directions add up in the section's corners
    has_section: bool = False  # whether its numbers are those of one `<section>`

    @property
    def varies(self) -> bool:
        """Whether a number of its section changes along it."""
        parts = [part.along for part in (self.y, self.z, self.torsion) if part is not None]
        return not all(along == CONSTANT for along in (self.mass_along, self.polar_along, *parts))

    @property
    def modes(self) -> tuple[int, int, int]:
        """Numbers of modes (y, z, torsion)."""
        count = [0 if part is None else part.modes for part in (self.y, self.z, self.torsion)]
        return count[0], count[1], count[2]

    def bending(self, direction: str) -> Deformation:
        """Return the bending along `y` or `z`, in which it must bend."""
        found = self.y if direction == 'y' else self.z
        assert found is not None
        return found

    @property
    def whole_length(self) -> float:
        """Length of the link's beam, all its segments together [m]."""
        return self.segments * self.length


@dataclass(frozen=True)
class ComponentModes:
    """The elastic part of a link reduced from finite elements; its body frame is the link's."""

    file: str  # its path
    link: ReducedLink
    stiffness: Array  # (m,) the file's, times the factor
    damping: Array  # (m,) coefficients
    factor: float = 1.0  # on the file's stiffness
    damping_ratio: Array | None = None  # (m,) or (1,), None where damping is not given by it

    @property
    def count(self) -> int:
        """Number of modes."""
        return self.link.modes

    @property
    def modal_stiffness(self) -> Array:
        """Stiffness (m,) of the modes, as beams call it."""
        return self.stiffness

    @property
    def unit_stiffness(self) -> Array:
        """Stiffness (m,) of the modes at a factor of 1."""
        return self.link.stiffness

    def with_stiffness(self, factor: float) -> ComponentModes:
        """Return the same with another factor on the file's stiffness, its damping as it was."""
        return replace(self, stiffness=factor * self.link.stiffness, factor=factor)

    @property
    def critical_damping(self) -> Array:
        """Critical damping (m,) of each mode with the link frame held."""
        return np.asarray(2.0 * np.sqrt(self.stiffness * self.link.modal_mass))

    @property
    def spans(self) -> Array:
        """Amplitude (m,) of each mode that displaces a frame by the link's size."""
        frames = self.link.frames.values()
        size = max([float(np.linalg.norm(frame.origin)) for frame in frames], default=0.0)
        size = size or float(np.linalg.norm(self.link.com))
        moved = [np.linalg.norm(frame.phi, axis=0) for frame in frames]
        moved.append(np.sqrt(self.link.modal_mass / self.link.mass))
        return np.asarray(size / np.max(moved, axis=0))

    @property
    def tip(self) -> str:
        """Name of the frame that is farthest from the link frame, '' where there is none."""
        frames = self.link.frames
        return max(frames, key=lambda name: float(np.linalg.norm(frames[name].origin)), default='')


@dataclass(frozen=True)
class FlexibleLink:
    """A link split in a beam (its segments) and a rigid rest, in the beam frame.

    Or in component modes and a rest, in the link frame: then there are no beams.
    """

    origin: Array  # (4, 4) beam frame seen from the link frame
    beams: tuple[Beam, ...]  # root first
    rest: RigidInertia
    modes: ComponentModes | None = None

    @property
    def beam(self) -> Beam | None:
        """The first segment."""
        return self.beams[0] if self.beams else None


@dataclass(frozen=True)
class Attachment:
    """Where a frame hangs: on a body, at a station of its beam or at a frame of its modes.

    `body` is -1 for the base. `station` [m] is 0 for the body frame itself (always so on a rigid
    body); else the placement is relative to the beam's cross-section there, which undeformed
    stands at (station, 0, 0) of the body frame with its axes. `section` names the frame of a link
    with component modes that the placement is relative to: its origin, with the body's axes.
    """

    body: int
    station: float
    placement: Array  # (4, 4) homogeneous, undeformed: frame seen from the body frame or section
    section: str = ''

    @property
    def deforms(self) -> bool:
        """Whether it moves on its body as that one deforms."""
        return self.station != 0.0 or self.section != ''


@dataclass(frozen=True)
class Body:
    """A body of the tree: a link with all fixed to it, or a lump at a beam's station.

    The body frame is the beam frame of a flexible link, else the link frame. A link that is
    fixed to a beam at station > 0 is a body of its own with a FIXED joint and no coordinates
    (a lump; links fixed to it in turn merge into it). A link whose beam is divided into segments
    is as many bodies, one after the other: the first has the link's name, joint and rigid rest,
    the others are named `link/2`, ... and fixed to the tip of the one before.
    """

    name: str  # of its link; `link/2`, ... of its further segments
    attachment: Attachment  # of the joint frame (URDF: where the joint's origin puts it)
    joint: Joint | None  # None: fixed
    frame: Array  # (4, 4) body frame seen from the link frame (= joint frame at q = 0)
    inertia: RigidInertia  # the rigid rest and all merged links, in the body frame
    beam: Beam | None = None
    floating: str = ''  # name of the floating joint that it is on, else empty
    segment: int = 1  # which of its link's segments it is, from 1 at the root
    modes: ComponentModes | None = None  # of a link reduced from finite elements: then no beam
    unloaded: RigidInertia | None = None  # its inertia without payloads; None: it has none

    @property
    def link(self) -> str:
        """The link that it is, or is a segment of."""
        return self.name if self.segment == 1 else self.name.rpartition('/')[0]

    @property
    def amplitudes(self) -> int:
        """Number of its amplitudes."""
        own = 0 if self.modes is None else self.modes.count
        return own if self.beam is None else sum(self.beam.modes)

    @property
    def spans(self) -> Array:
        """Size (amplitudes,) of each amplitude: the link's, 1 rad of twist."""
        if self.modes is not None:
            return self.modes.spans
        if self.beam is None:
            return np.zeros(0)
        ny, nz, nt = self.beam.modes
        return np.concatenate([np.full(ny + nz, self.beam.length), np.ones(nt)])

    @property
    def start(self) -> float:
        """Station of the body frame on the link's whole beam [m]."""
        return 0.0 if self.beam is None else (self.segment - 1) * self.beam.length


# sensors: a new type is a row of one of two tables ----------------------------------------------


@dataclass(frozen=True)
class BeamSensorKind:
    """A type of `<sensor>` on a beam."""

    quantity: str  # strain | deflection | moment | shear; '' where `component` says which
    attributes: tuple[str, ...] = ()  # beside those of all sensors on beams
    on_mesh: bool = False  # whether it may be on a <flexible>


@dataclass(frozen=True)
class InertialSensorKind:
    """A type of `<sensor>` that reads the motion of its axes."""

    vectors: tuple[str, ...]  # of `INERTIAL_UNITS`, in that order
    message: str  # type of its topic

    @cached_property
    def parts(self) -> tuple[str, ...]:
        """Names of its values."""
        return tuple(f'{vector}_{axis}' for vector in self.vectors for axis in 'xyz')

    @cached_property
    def columns(self) -> slice:
        """Its values among angular rate and specific force (6,)."""
        first = 3 * list(INERTIAL_UNITS).index(self.vectors[0])
        return slice(first, first + 3 * len(self.vectors))


BEAM_SENSORS = {
    'strain_gauge': BeamSensorKind('strain', ('surface',), on_mesh=True),
    'load_cell': BeamSensorKind('', ('component',)),
    'deflection': BeamSensorKind('deflection'),
}
INERTIAL_UNITS = {'gyro': 'rad/s', 'accel': 'm/s^2'}
INERTIAL_SENSORS = {
    'imu': InertialSensorKind(('gyro', 'accel'), 'sensor_msgs/msg/Imu'),
    'accelerometer': InertialSensorKind(('accel',), 'geometry_msgs/msg/AccelStamped'),
}


@dataclass(frozen=True)
class SensorElement:
    """`<sensor>` of a flexible link, as the file says it."""

    name: str
    type: str  # of `BEAM_SENSORS`
    link: str
    station: float  # m, on the link's whole beam
    direction: str  # y | z
    surface: float  # m, of a strain gauge
    component: str  # moment | shear for a load cell, else ''
    gain: float
    offset: float
    noise: float
    topic: str
    field: str  # index or name in the message, '' if not given
    point: str  # strain point of a link with component modes

    @property
    def quantity(self) -> str:
        """Quantity of its section that it reads: strain, deflection, moment or shear."""
        return self.component or BEAM_SENSORS[self.type].quantity


@dataclass(frozen=True)
class Sensor(SensorElement):
    """A sensor and its row: predicted value = row . coordinates from its body's amplitudes on.

    A strain gauge or load cell reads the segment that holds its station, in the axes of that
    segment. A deflection sensor on a link of several segments reads all of them up to its
    station: then `body` is the first, and the row is that of small deflections.
    """

    body: int
    row: Array  # (m,) d(value)/d(amplitude), in the value's unit


@dataclass(frozen=True)
class InertialElement:
    """Inertial `<sensor>`; noise and bias are standard deviations per axis."""

    name: str
    type: str  # of `INERTIAL_SENSORS`
    link: str
    station: float | None  # m, on a link with a beam
    origin: Array  # (4, 4) of its axes, seen from the section or the link frame
    topic: str
    first: int  # place of its first value among those of all sensors
    gyro_noise: float  # rad/s
    accel_noise: float  # m/s^2
    gyro_bias: float  # rad/s, of a constant that is not known
    accel_bias: float  # m/s^2

    @property
    def kind(self) -> InertialSensorKind:
        """Row of `INERTIAL_SENSORS`."""
        return INERTIAL_SENSORS[self.type]

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of its values: six of an IMU, three of an accelerometer."""
        return self.kind.parts

    def deviations(self, cause: str) -> Array:
        """Return the standard deviation of each of its values by `noise` or `bias`."""
        return np.repeat([getattr(self, f'{name}_{cause}') for name in self.kind.vectors], 3)


@dataclass(frozen=True)
class InertialSensor(InertialElement):
    """An inertial sensor on a link."""

    mount: Attachment  # of its axes

    @property
    def frame(self) -> str:
        """Name of the frame of its axes, as the robot's verbs take it."""
        return f'sensor:{self.name}'


@dataclass(frozen=True)
class LoopFrame:
    """One side of a loop joint: its frame's name in `Tree.frames` and its link."""

    link: str
    frame: str


@dataclass(frozen=True)
class Loop:
    """A joint that closes a kinematic loop."""

    name: str
    type: str  # revolute | prismatic | universal | spherical | fixed
    parent: LoopFrame
    child: LoopFrame
    axis: Array | None  # (3,) unit, parent's loop frame
    axis2: Array | None  # (3,) unit, child's loop frame (universal)
    damping: float = 0.0
    friction: float = 0.0


@dataclass(frozen=True)
class Tree:
    """An immutable robot: bodies in coordinate order (depth first, parents before children)."""

    name: str
    bodies: tuple[Body, ...]
    frames: Mapping[str, Attachment]  # every link's frame and every loop frame, by name
    loops: tuple[Loop, ...] = ()
    sensors: tuple[Sensor, ...] = ()
    warnings: tuple[str, ...] = ()
    source: str = ''  # the URDF text it was read from
    overrides: Mapping[str, Any] = field(default_factory=dict)  # applied on top, by dotted path
    inertial_sensors: tuple[InertialSensor, ...] = ()  # `sensors` has those on beams
    folder: str = ''  # of the description's file: files that it names are relative to it
    payloads: Mapping[str, Payload] = field(default_factory=dict)  # by link; bodies carry them

    @cached_property
    def sensor_names(self) -> tuple[str, ...]:
        """Names of all sensors' values in file order: `gauge`, `imu/gyro_x`, `imu/accel_z`."""
        names = [sensor.name for sensor in self.sensors]
        for sensor in self.inertial_sensors:  # in file order: those before stand already
            own = [f'{sensor.name}/{part}' for part in sensor.parts]
            names[sensor.first : sensor.first] = own
        return tuple(names)

    @cached_property
    def beam_sensor_places(self) -> list[int]:
        """Places of the values of `sensors` among those of all sensors."""
        taken = {k for s in self.inertial_sensors for k in range(s.first, s.first + len(s.parts))}
        return [k for k in range(len(self.sensors) + len(taken)) if k not in taken]

    @cached_property
    def joints(self) -> dict[str, Joint]:
        """The joints that move, by name, in coordinate order."""
        return {body.joint.name: body.joint for body in self.bodies if body.joint is not None}

    @property
    def non_mimic_joints(self) -> tuple[str, ...]:
        """Names of the joints that mimic none, in coordinate order."""
        return tuple(name for name, joint in self.joints.items() if joint.mimic is None)

    @property
    def mimics(self) -> dict[str, Mimic]:
        """Each mimic joint's constraint to a joint that mimics none: chains are resolved."""
        direct = {name: joint.mimic for name, joint in self.joints.items() if joint.mimic}
        resolved = {}
        for name, mimic in direct.items():
            while (further := direct.get(mimic.leader)) is not None:
                offset = mimic.multiplier * further.offset + mimic.offset
                mimic = Mimic(further.leader, mimic.multiplier * further.multiplier, offset)
            resolved[name] = mimic
        return resolved
