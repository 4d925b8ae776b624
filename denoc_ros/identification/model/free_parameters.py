"""Which numbers of a robot are free, and the robot that they make.

The search goes over coordinates without bounds, 0 where the robot is now: a number that must be
positive is its value times exp(theta), any other its value plus a scale times theta. The ten
numbers of a rigid body are U T(theta) of its pseudo-inertia U U^T, T upper triangular with a
positive diagonal: every theta is a body that can exist (P. M. Wensing, S. Kim, J.-J. Slotine,
Linear matrix inequalities for physically consistent inertial parameter identification, IEEE
Robotics and Automation Letters 3, 2018).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.parameter_columns import INERTIAL
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.robot_model import with_numbers_of
from denoc_ros.errors import ConfigError
from denoc_ros.identification.model.structural_effect import reading_changes
from denoc_ros.model.arrays import inertia_row
from denoc_ros.model.inertia import difference, inverse_transform, moved, pseudo_inertia, total
from denoc_ros.model.link_side import motors_behind
from denoc_ros.model.numbers import match, some_of, values_of
from denoc_ros.model.payloads import NO_PAYLOAD, carrying_links
from denoc_ros.model.tree import INERTIAL_UNITS, Body, RigidInertia
from denoc_ros.types import Array

SMALL_RATIO = 0.01  # what a damping ratio that is 0 changes by
SMALL_FRICTION = 0.02  # the same of friction, of the joint's largest torque
OFFSET = 0.1  # of effort, of its largest
PAYLOAD = 0.1  # of the robot's mass: a payload's where the model has none, at most 1 kg
LEVER = 0.1  # m, of a payload's centre of mass
DELAY = 0.01  # s
INERTIAL_OFFSET = {'gyro': 0.1, 'accel': 1.0}  # rad/s, m/s^2: of sensors that were not recorded
POSE_OFFSET = 0.1  # m or rad, between a tracker's axes and the robot's
POSE_PARTS = ('x', 'y', 'z', 'rx', 'ry', 'rz')


@dataclass(frozen=True)
class FreeNumber:
    """A number that may be free."""

    path: str
    value: float  # as the robot has it
    scale: float  # what it changes by per theta; of a positive one the least size that counts
    positive: bool  # it is value times exp(theta)
    run: str = ''  # the recording whose number it is; '': all of them share it

    @property
    def shared_path(self) -> str:
        """The path without the recording."""
        return self.path.removesuffix(f'[{self.run}]') if self.run else self.path

    def in_run(self, run: str) -> FreeNumber:
        """Return the same number of one recording: `effort.joint_1.offset[monday.mcap]`."""
        return replace(self, path=f'{self.path}[{run}]', run=run)

    def at(self, theta: float) -> float:
        """Return the number at a coordinate of the search."""
        if self.positive:
            return float(self.value * np.exp(theta))
        return float(self.value + self.scale * theta)


def free_numbers(
    robot: Robot, efforts: Mapping[str, float], spreads: Mapping[str, float]
) -> list[FreeNumber]:
    """Return every number of a robot that may be free.

    Parameters
    ----------
    spreads : dict of str to float
        By how much the value of each sensor was measured to vary, by its name.
    """
    found: list[FreeNumber] = []
    for path, value in values_of(robot.tree).items():
        found.extend(_of_model(path, float(np.ravel(np.asarray(value))[0]), efforts, spreads))
    for joint in robot.tree.joints:
        found.append(FreeNumber(f'effort.{joint}.gain', 1.0, 0.0, True))
        scale = OFFSET * efforts.get(joint, 1.0)
        found.append(FreeNumber(f'effort.{joint}.offset', 0.0, scale, False))
    for link in carrying_links(robot.tree):
        load = robot.tree.payloads.get(link, NO_PAYLOAD)
        found.append(_positive(f'payload.{link}.mass', load.mass, _payload_scale(robot)))
        found.extend(
            FreeNumber(f'payload.{link}.com.{axis}', float(value), LEVER, False)
            for axis, value in zip('xyz', load.com, strict=True)
        )
    found.extend(_of_channels(robot, spreads))
    return found


def _of_channels(robot: Robot, spreads: Mapping[str, float]) -> Iterator[FreeNumber]:
    """Yield parameters of the sensors: delays, axes, biases."""
    for sensor in robot.tree.sensors:
        yield FreeNumber(f'delay.{sensor.name}', 0.0, DELAY, False)
    yield FreeNumber('delay.effort', 0.0, DELAY, False)
    for inertial in robot.tree.inertial_sensors:
        yield FreeNumber(f'delay.{inertial.name}', 0.0, DELAY, False)
        for part in inertial.parts:
            usual = INERTIAL_OFFSET[part.partition('_')[0]]
            spread = spreads.get(f'{inertial.name}/{part}', usual)
            yield FreeNumber(f'sensor.{inertial.name}.gain.{part}', 1.0, 0.0, True)
            yield FreeNumber(f'sensor.{inertial.name}.offset.{part}', 0.0, spread or usual, False)
    for frame in robot.tree.frames:
        yield FreeNumber(f'delay.pose.{frame}', 0.0, DELAY, False)
        for part in POSE_PARTS:
            yield FreeNumber(f'pose.{frame}.offset.{part}', 0.0, POSE_OFFSET, False)


def _of_model(
    path: str, value: float, efforts: Mapping[str, float], spreads: Mapping[str, float]
) -> list[FreeNumber]:
    """Return the number of a path of the model; none where it is no number to be identified."""
    kind, _, rest = path.partition('.')
    name, _, term = rest.rpartition('.')
    if kind == 'beam':
        return [_positive(path, value, 0.0 if term in ('ei', 'gj') else SMALL_RATIO)]
    if kind == 'flexible':
        return [_positive(path, value, 0.0 if term == 'stiffness' else SMALL_RATIO)]
    if kind == 'joint' and term == 'stiffness':
        return [FreeNumber(path, value, 0.0, True)]
    if kind == 'joint' and (value > 0.0 or term in ('damping', 'friction', 'armature')):
        return [_positive(path, value, SMALL_FRICTION * efforts.get(name, 1.0))]
    if kind == 'sensor' and term == 'gain':
        return [FreeNumber(path, value, 0.0, True)]
    if kind == 'sensor' and term == 'offset':
        return [FreeNumber(path, value, spreads.get(name, 0.0) or abs(value) or 1.0, False)]
    return []


def _positive(path: str, value: float, scale: float) -> FreeNumber:
    """Return a number that must not be negative; one that is 0 starts from its scale's share."""
    return FreeNumber(path, value if value > 0.0 else scale, scale, True)


def _payload_scale(robot: Robot) -> float:
    """Return the least mass of a payload that counts [kg]."""
    return min(1.0, PAYLOAD * moving_mass(robot)) or 1.0


def moving_mass(robot: Robot) -> float:
    """Return the mass of a robot's rigid bodies, beams and links with component modes [kg]."""
    beams = [body.beam for body in robot.tree.bodies if body.beam is not None]
    mass = sum(body.inertia.mass for body in robot.tree.bodies)
    mass += sum(beam.mass_per_length * beam.length for beam in beams)
    mass += sum(body.modes.link.mass for body in robot.tree.bodies if body.modes is not None)
    return float(mass)


def unit_of(path: str) -> str:
    """Return the unit of a number that may have any sign, '' of a sensor's own."""
    kind, _, rest = path.partition('[')[0].partition('.')
    if kind == 'link':
        return 'kg m' if '.first_moment.' in rest else 'kg m^2'
    if kind == 'pose':
        return 'rad' if rest.rpartition('.')[2] in ('rx', 'ry', 'rz') else 'm'
    if kind == 'sensor':
        part = rest.rpartition('.')[2].partition('_')[0]
        return INERTIAL_UNITS.get(part, '')
    return {'delay': 's', 'effort': 'N m or N', 'payload': 'm'}.get(kind, '')


WHERE = 'identify model'
# deviation of theta before anything is measured: a factor of e^(+-1) covers what is guessed badly
PRIOR = 0.5
KINDS = ('beam.', 'joint.', 'payload.', 'link.', 'sensor.', 'effort.', 'pose.', 'delay.')
ROUNDING = 1e-9  # of a pseudo-inertia: what arithmetic leaves of an exact zero
STEP = 1e-6  # of theta, for derivatives of numbers
CHANGE = 1e-3  # of theta, by which numbers without effect show
# of readings, by a number's size: joint axes that are rounded to 1e-5 rad show no more
LEAST_EFFECT = 1e-5
SMALLEST = 1e-6  # of a body's pseudo-inertia: point masses and flat plates get so much
UPPER = np.triu_indices(4)
# what drifts: each recording has its own
DRIFTING = re.compile(r'(effort|sensor)\..+\.offset(\.(gyro|accel)_[xyz])?')
SENSOR_OFFSET = re.compile(r'sensor\..+\.offset(\.(gyro|accel)_[xyz])?')


@dataclass(frozen=True)
class SearchPoint:
    """Values of all free numbers at a point of the search."""

    # of the robot, by dotted path
    overrides: dict[str, float | list[float]] = field(default_factory=dict)
    bodies: dict[str, RigidInertia] = field(default_factory=dict)  # by name, in the body frame
    # of measured effort, by joint: effort = gain * torque + offset
    gains: dict[str, float] = field(default_factory=dict)
    offsets: dict[str, float] = field(default_factory=dict)  # of that [N m, N]
    # by channel [s]: how much later than the joints it is stamped
    delays: dict[str, float] = field(default_factory=dict)
    # gains and offsets of sensors, axes of trackers, by dotted path
    channels: dict[str, float] = field(default_factory=dict)
    # offsets of effort and sensors that each recording has of its own, by its name and path
    by_run: dict[str, dict[str, float]] = field(default_factory=dict)

    def of_run(self, run: str) -> SearchPoint:
        """Return the point as it holds in one recording."""
        if not (own := self.by_run.get(run)):
            return self
        offsets, channels = dict(self.offsets), dict(self.channels)
        for path, value in own.items():
            if path.startswith('effort.'):
                offsets[path.removeprefix('effort.').removesuffix('.offset')] = value
            else:
                channels[path] = value
        return replace(self, offsets=offsets, channels=channels)


class InertialBlock:
    """Ten inertial numbers of a body and all fixed to it, about its link frame's origin."""

    def __init__(self, body: Body) -> None:
        self.path = f'link.{body.name}.inertial'
        self.name = body.name
        self.paths = tuple(f'link.{body.name}.{number}' for number in INERTIAL)
        self._to_body = inverse_transform(body.frame)
        self._start = moved(body.inertia, body.frame)
        pseudo = pseudo_inertia(self._start, 1.0)
        size = np.trace(pseudo[:3, :3]) / pseudo[3, 3]
        self.length = float(np.sqrt(size)) if size > 0.0 else LEVER
        units = np.array([self.length] * 3 + [1.0])
        floor = SMALLEST * pseudo[3, 3] * np.diag(units**2)
        # the upper triangular U with U U^T
        turned = np.linalg.cholesky((pseudo + floor)[::-1, ::-1])
        self._factor = np.ascontiguousarray(turned[::-1, ::-1])

    @property
    def scales(self) -> Array:
        """Units of the ten inertial numbers (10,)."""
        m, length = self._start.mass, self.length
        return m * np.array([1.0] + [length] * 3 + [length**2] * 6)

    def body(self, theta: Array) -> RigidInertia:
        """Return the body in the body frame."""
        return moved(self._about_link(theta), self._to_body)

    def change(self, theta: Array) -> RigidInertia:
        """Change of the body's inertia since the start, about the link frame's origin."""
        return difference(self._about_link(theta), self._start)

    def numbers(self, theta: Array) -> Array:
        """Return the ten numbers about the link frame's origin (10,)."""
        return inertia_row(self._about_link(theta), np.eye(3))

    def _about_link(self, theta: Array) -> RigidInertia:
        triangle = np.zeros((4, 4))
        triangle[UPPER] = theta
        np.fill_diagonal(triangle, np.exp(np.diag(triangle)))
        factor = self._factor @ triangle
        pseudo = factor @ factor.T
        second = pseudo[:3, :3]
        return RigidInertia(
            float(pseudo[3, 3]), pseudo[:3, 3], np.trace(second) * np.eye(3) - second
        )


class FreeParameters:
    """The free numbers of a robot.

    Parameters
    ----------
    robot : Robot
        Where the search starts.
    free : sequence of str
        Dotted paths; `*` and `?` stand for others. `beam.<link>.<y|z>.<ei|damping_ratio>`,
        `beam.<link>.torsion.<gj|damping_ratio>`, `joint.<joint>.<damping|friction|armature>`,
        `payload.<link>` (mass and centre of mass) or `payload.<link>.mass`,
        `link.<link>.inertial`, `sensor.<name>.<gain|offset>` (of an IMU each axis of it),
        `effort.<joint>.<gain|offset>`, `pose.<frame>.offset`, `delay.effort`, `delay.<sensor>` and
        `delay.pose.<frame>`.
    efforts : dict of str to float, optional
        The largest measured torque of each joint: the scale of what it is made of.
    spreads : dict of str to float, optional
        By how much the value of each sensor was measured to vary: the scale of its offset.
    runs : sequence of str, optional
        Names of the recordings. Of several, each has offsets of effort and sensors of its own:
        they drift with temperature and time. Their paths end with `[name]`.

    Raises
    ------
    ConfigError
        A path that is of nothing; every finding.
    """

    def __init__(
        self,
        robot: Robot,
        free: Sequence[str],
        efforts: Mapping[str, float] | None = None,
        spreads: Mapping[str, float] | None = None,
        runs: Sequence[str] = (),
    ) -> None:
        self.robot = robot
        numbers = {n.path: n for n in free_numbers(robot, efforts or {}, spreads or {})}
        bodies = filter(_is_possible, robot.tree.bodies)
        blocks = {block.path: block for block in map(InertialBlock, bodies)}
        hidden = _hidden(robot, numbers)
        chosen = _chosen(
            free, [path for path in (*numbers, *blocks) if path not in hidden], hidden
        )
        self.numbers = []
        for number in (numbers[path] for path in chosen if path in numbers):
            drifts = len(runs) > 1 and DRIFTING.fullmatch(number.path) is not None
            self.numbers += [number.in_run(run) for run in runs] if drifts else [number]
        self.blocks = [blocks[path] for path in chosen if path in blocks]
        self.paths = tuple(
            [number.path for number in self.numbers]
            + [path for block in self.blocks for path in block.paths]
        )
        self.size = len(self.numbers) + 10 * len(self.blocks)

    @property
    def multiplicative(self) -> NDArray[np.bool_]:
        """Which reported numbers are factors of their start (p,)."""
        return np.array([n.positive for n in self.numbers] + [False] * (10 * len(self.blocks)))

    @property
    def is_sensor_offset(self) -> NDArray[np.bool_]:
        """Whether each reported number is a sensor's reading at zero (p,)."""
        of_numbers = [SENSOR_OFFSET.fullmatch(n.shared_path) is not None for n in self.numbers]
        return np.array(of_numbers + [False] * (10 * len(self.blocks)))

    @property
    def moves_robot(self) -> NDArray[np.bool_]:
        """Which coordinates of the search change the motion of amplitudes and links (p,)."""
        measuring = ('sensor.', 'effort.', 'pose.', 'delay.')
        found = [
            not number.path.startswith(measuring) and not self._is_friction(number.path)
            for number in self.numbers
        ]
        return np.array(found + [True] * (10 * len(self.blocks)))

    @cached_property
    def has_effect(self) -> NDArray[np.bool_]:
        """Which reported numbers a measurement of the robot can depend on, in some motion (p,).

        Numbers of sensors, of measured effort and of friction always do.
        """
        zero, places = np.zeros(self.size), np.flatnonzero(self.moves_robot)
        steps = [side * CHANGE * np.eye(self.size)[k] for k in places for side in (1.0, -1.0)]
        sides = [self.robot_at(self.settings(step)) for step in steps]
        changes = reading_changes(self.robot_at(self.settings(zero)), sides)
        by_theta = (changes[:, ::2] - changes[:, 1::2]) / (2.0 * CHANGE)
        by_numbers = by_theta @ np.linalg.inv(self.slopes(zero)[np.ix_(places, places)])
        effect = np.abs(by_numbers * self.scales(zero)[places]).max(axis=0, initial=0.0)
        found = np.ones(self.size, dtype=bool)
        found[places] = effect > LEAST_EFFECT
        return found

    @property
    def is_searched(self) -> NDArray[np.bool_]:
        """Which coordinates of the search a measurement can depend on (p,): all of a body's."""
        return np.where(np.arange(self.size) < len(self.numbers), self.has_effect, True)

    @property
    def runs(self) -> list[str]:
        """The recording that each number is of; '': of all (p,)."""
        return [number.run for number in self.numbers] + [''] * (10 * len(self.blocks))

    def values(self, theta: Array) -> Array:
        """Return the reported numbers (p,), in the order of `paths`."""
        found = [number.at(t) for number, t in zip(self.numbers, theta, strict=False)]
        for block, own in self._of_blocks(theta):
            found.extend(block.numbers(own))
        return np.array(found)

    def point(self, values: Mapping[str, float]) -> Array:
        """Return the coordinates of the search (p,) of numbers by path, bodies as at the start."""
        found = np.zeros(self.size)
        for k, number in enumerate(self.numbers):
            value = values.get(number.path, number.value)
            if number.positive:
                found[k] = np.log(value / number.value)
            else:
                found[k] = (value - number.value) / number.scale
        return found

    def scales(self, theta: Array) -> Array:
        """Size of each reported number (p,)."""
        sizes = [
            max(abs(number.at(t)), number.scale) if number.positive else abs(number.scale)
            for number, t in zip(self.numbers, theta, strict=False)
        ]
        return np.concatenate([sizes, *(block.scales for block in self.blocks)])

    def sizes(self, theta: Array) -> Array:
        """Reference that the interval of each reported number is divided by in its verdict (p,).

        The number itself where it must be positive, masses included; of a payload's centre how far
        it is from the link's origin, where that is more than what `scales` says.
        """
        values, scales = self.values(theta), self.scales(theta)
        masses = np.array([path.endswith('.mass') for path in self.paths])
        found = np.where(self.multiplicative | masses, np.abs(values), scales)
        centres = [path.rpartition('.')[0] for path in self.paths]
        for centre in {each for each in centres if each.endswith('.com')}:
            own = np.array([each == centre for each in centres])
            found[own] = np.maximum(found[own], np.linalg.norm(values[own]))
        return np.asarray(found)

    def slopes(self, theta: Array) -> Array:
        """Return the derivatives of the reported numbers by theta (p, p)."""
        found = np.zeros((self.size, self.size))
        for k, (number, t) in enumerate(zip(self.numbers, theta, strict=False)):
            found[k, k] = (number.at(t + STEP) - number.at(t - STEP)) / (2.0 * STEP)
        first = len(self.numbers)
        for block, own in self._of_blocks(theta):
            for k, change in enumerate(STEP * np.eye(10)):
                sides = block.numbers(own + change) - block.numbers(own - change)
                found[first : first + 10, first + k] = sides[:] / (2.0 * STEP)
            first += 10
        return found

    def linear(self, joints: Set[str]) -> tuple[list[int], list[str]]:
        """Return places and paths of the numbers that a rigid robot's torque is linear in.

        There are none where loops or mimic joints make joints follow others, unless none of
        those is recorded: fingers that stand still are a body like any other.
        """
        tree = self.robot.tree
        is_tied = bool(tree.loops) or any(
            mimic.offset != 0.0 or joints & {name, mimic.leader}
            for name, mimic in tree.mimics.items()
        )
        if len(self.robot.flexible_indices) or is_tied:
            return [], []
        found = [k for k, path in enumerate(self.paths) if path.startswith(('joint.', 'link.'))]
        return found, [self.paths[k] for k in found]

    def settings(self, theta: Array) -> SearchPoint:
        """Decode a point of the search."""
        found = SearchPoint()
        coms: dict[str, dict[int, float]] = {}
        for number, t in zip(self.numbers, theta, strict=False):
            value = number.at(t)
            kind, _, rest = number.path.partition('.')
            if number.run:
                found.by_run.setdefault(number.run, {})[number.shared_path] = value
            elif kind == 'effort' and rest.endswith('.offset'):
                found.offsets[rest.removesuffix('.offset')] = value
            elif kind == 'effort':
                found.gains[rest.removesuffix('.gain')] = value
            elif kind == 'delay':
                found.delays[rest] = value
            elif kind in ('pose', 'sensor'):
                found.channels[number.path] = value
            elif kind == 'payload' and '.com.' in rest:
                link, _, axis = rest.rpartition('.com.')
                coms.setdefault(link, {})['xyz'.index(axis)] = value
            else:
                found.overrides[number.path] = value
        for link, parts in coms.items():
            centre = self.robot.tree.payloads.get(link, NO_PAYLOAD).com.tolist()
            for place, value in parts.items():
                centre[place] = value
            found.overrides[f'payload.{link}.com'] = centre
        for block, own in self._of_blocks(theta):
            found.bodies[block.name] = block.body(own)
        return found

    def changes(self, theta: Array) -> dict[str, RigidInertia]:
        """Change of each free body's inertia since the start, about its link frame's origin."""
        return {block.name: block.change(own) for block, own in self._of_blocks(theta)}

    def _of_blocks(self, theta: Array) -> Iterator[tuple[InertialBlock, Array]]:
        """Yield each body with its ten coordinates of the search."""
        return zip(self.blocks, theta[len(self.numbers) :].reshape(-1, 10), strict=True)

    def overrides(self, settings: SearchPoint) -> dict[str, float | list[float]]:
        """Overrides of a point of the search, without its bodies.

        A sensor whose offset each recording has of its own gets their mean.
        """
        beams = {sensor.name for sensor in self.robot.tree.sensors}
        by_path: dict[str, list[float]] = {}
        for own in settings.by_run.values():
            for path, value in own.items():
                by_path.setdefault(path, []).append(value)
        means = {path: float(np.mean(values)) for path, values in by_path.items()}
        of_sensors = {
            path: value
            for path, value in {**settings.channels, **means}.items()
            if path.removeprefix('sensor.').rpartition('.')[0] in beams
        }
        return {**settings.overrides, **of_sensors}

    def moving(self, settings: SearchPoint) -> dict[str, float | list[float]]:
        """Return the overrides that change more than torque of joints that move as recorded."""
        given = settings.overrides.items()
        return {path: value for path, value in given if not self._is_friction(path)}

    def _is_friction(self, path: str) -> bool:
        """Say whether a number acts along its own joint alone."""
        if self.robot.constraint_names or not path.startswith('joint.'):
            return False
        return path.rpartition('.')[2] in ('damping', 'friction', 'armature')

    def robot_at(self, settings: SearchPoint) -> Robot:
        """Return the robot of a point of the search."""
        overrides = self.overrides(settings)
        robot = self.robot.with_overrides(overrides) if overrides else self.robot
        if not settings.bodies:
            return robot.copy() if robot is self.robot else robot
        bodies = []
        for body, own in zip(robot.tree.bodies, self.robot.tree.bodies, strict=True):
            if (found := settings.bodies.get(body.name)) is not None:
                # a payload of the point stays on it
                added = difference(body.inertia, own.inertia)
                body = replace(body, inertia=total(found, added), unloaded=body.unloaded and found)
            bodies.append(body)
        return with_numbers_of(robot, replace(robot.tree, bodies=tuple(bodies)))


def _hidden(robot: Robot, paths: Iterable[str]) -> set[str]:
    """Paths on the far side of springs, seen from the side that joint states and effort mean."""
    motors = motors_behind(robot.tree)
    return {
        path
        for path in paths
        if path.startswith('joint.') and path.split('.', 1)[1].rpartition('.')[0] in motors
    }


def _chosen(free: Sequence[str], known: Sequence[str], hidden: Set[str]) -> list[str]:
    """Return the known paths that the patterns match, each once, in their order."""
    chosen: dict[str, None] = {}
    findings = []
    for pattern in free:
        several = pattern.startswith(('payload.', 'sensor.', 'pose.'))
        given = f'{pattern}.*' if several else pattern
        matched = match(known, pattern, given)
        if not matched and match(hidden, pattern):
            findings.append(
                f'--free {pattern!r} must be of what joint states show; got a motor or spring of '
                'a joint that is measured on the link side (measured="link")'
            )
        elif not matched:
            shown = some_of(known, pattern, KINDS)
            findings.append(f'--free {pattern!r} must be of one of {shown}; got none')
        chosen.update(dict.fromkeys(matched))
    if not free:
        findings.append('--free must name what is free, got nothing')
    ConfigError.raise_any(WHERE, findings)
    return list(chosen)


def _is_possible(body: Body) -> bool:
    if body.beam is not None or body.modes is not None or not body.inertia.mass > 0.0:
        return False
    values = np.linalg.eigvalsh(pseudo_inertia(body.inertia, 1.0))
    return bool(values[0] >= -ROUNDING * values[-1])
