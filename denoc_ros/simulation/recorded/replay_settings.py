"""Settings of a replay, and its sources in the bag."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from denoc_ros.bags.joint_state import JOINT_STATE
from denoc_ros.bags.reader import STAMP, BagContents, Stamp, bag_contents, require_stamp
from denoc_ros.bags.run import RecordedPhase
from denoc_ros.bags.series import ODOMETRY, JointSeries, find_topic, joint_state_blocks, renamed
from denoc_ros.dynamics.elastic.deflection import TipDeflections
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import BagError, ConfigError, StateError
from denoc_ros.estimation.joint_motion import METHODS
from denoc_ros.settings import declared_findings, documented, positive, setting
from denoc_ros.simulation.recorded.plausibility import angular_joints
from denoc_ros.simulation.recorded.recorded_stream import Source
from denoc_ros.types import Array

PREFIX = '/replay/'
COMMANDED = 'feedforward/effort'
DEFLECTIONS = ('plant/true_deflection', 'predictor/tip_deflection')
LOOKED_AT = 2000  # messages that say which joints there are, and where they start


@documented
@dataclass(frozen=True)
class ReplaySettings:
    """How a replay is made.

    Attributes
    ----------
    joints : tuple of str
        The driven joints, as the robot calls them; empty: all that mimic none. In a mechanism
        they must determine its motion.
    rename : mapping of str to str
        Beginnings of joint names in the bag and what they are in the robot.

    Raises
    ------
    ConfigError
        With every value that is out of range.
    BagError
        For stamps that no bag has.
    """

    topic: str = setting(
        '', 'topic of the joint states; default: joint_states, or the first with such an ending'
    )
    joints: tuple[str, ...] = ()
    effort: str = setting(
        '', 'topic of a JointState with the measured effort; default: that of the joint states'
    )
    rename: Mapping[str, str] = field(default_factory=dict)
    derivative: str = setting(
        'filter',
        'method for velocities and accelerations: local polynomials, or a Kalman smoother',
        choices=METHODS,
    )
    cutoff: float = positive(20.0, 'bandwidth of this method', 'Hz')
    stamp: Stamp = setting(STAMP)
    fit_friction: bool = setting(
        False,
        'fit viscous and Coulomb friction and an offset per joint to the measured effort, and '
        "use them in place of the robot's",
    )
    base: str = setting(
        '',
        'topic of a nav_msgs/Odometry with the motion of the base; default: base_motion, where '
        'the base of the robot floats',
    )

    def __post_init__(self) -> None:
        require_stamp('replay', self.stamp)
        ConfigError.raise_any('replay', declared_findings(self))


@dataclass(frozen=True)
class ReplayPlan:
    """Settings of a replay that come from its bag."""

    contents: BagContents  # of the bag
    source: Source  # messages that are read for the motion, and beside it
    joints: tuple[str, ...]  # the driven ones, as the robot calls them
    # joints of the bag that are not driven: the robot does not have them, or they follow others
    ignored: tuple[str, ...]
    posture: Array  # (n,) coordinates of the robot as the bag has them first, else 0
    # topics of the measured effort, and of a feedforward's; '' for none
    effort: str
    commanded: str
    deflections: tuple[str, ...]  # topics with deflections to compare with
    base: str = ''  # topic of the base's motion; '' for none

    @property
    def messages(self) -> int:
        """Number of joint states."""
        return next(t.messages for t in self.contents.topics if t.name == self.source.topic)


def plan_replay(
    path: Path,
    robot: Robot,
    settings: ReplaySettings,
    floats: bool = False,
    phases: Sequence[RecordedPhase] = (),
) -> ReplayPlan:
    """Select the topics of a bag for the replay of a robot; a base that `floats` is held here.

    Only the joint states of the phases are read; without phases all of them.

    Raises
    ------
    BagError
        The bag cannot be read, or has no joint states of the robot.
    StateError
        The base floats and the bag does not say how it moved.
    """
    contents = bag_contents(path)
    series = [topic.name for topic in contents.topics if topic.type == JOINT_STATE]
    present = [t.name for t in contents.topics if t.type == JOINT_STATE and t.messages]
    topic = settings.topic or find_topic(present, 'joint_states')
    if topic not in present:
        raise BagError(
            f'{path}: bag must have messages of {JOINT_STATE} on '
            f'{settings.topic or "a topic such as joint_states"}, got '
            f'{_listed(f"{t.name} ({t.messages} of {t.type})" for t in contents.topics)}'
        )
    if settings.effort and settings.effort not in series:
        raise BagError(
            f'{path}: effort must come from a topic of {JOINT_STATE} ({_listed(series)}), '
            f'got {settings.effort!r}'
        )
    beginning = next(joint_state_blocks(path, [topic], LOOKED_AT))[topic]
    found = renamed(beginning.names, settings.rename)
    driven = robot.tree.non_mimic_joints
    joints = settings.joints or tuple(name for name in driven if name in found)
    if not joints:
        raise BagError(
            f'{path}: joints on {topic} must be among those of {robot.tree.name} '
            f'({_listed(driven)}), got {_listed(found)}; a beginning that differs can be renamed'
        )
    if unknown := [name for name in joints if name not in found]:
        raise BagError(
            f'{path}: joints must be among those on {topic} ({_listed(found)}), '
            f'got {_listed(unknown)}'
        )
    commanded = find_topic(present, COMMANDED)
    deflections = [find_topic(present, ending) for ending in DEFLECTIONS]
    bends = bool(TipDeflections(robot).names)
    deflections = [name for name in deflections if name and bends]
    efforts = dict.fromkeys([settings.effort, commanded], 'effort')
    beside = {**efforts, **dict.fromkeys(deflections, 'position')}
    names = tuple(found[name] for name in joints)
    return ReplayPlan(
        contents,
        Source(
            path,
            topic,
            names,
            {t: f for t, f in beside.items() if t},
            settings.stamp,
            tuple(phases) or (RecordedPhase(''),),
            tuple(angular_joints(robot.tree, joints).tolist()),
        ),
        joints,
        tuple(name for name in found if name not in joints),
        _posture(robot, found, beginning),
        settings.effort,
        commanded,
        tuple(deflections),
        _base_topic(path, robot, contents, settings, floats),
    )


def _base_topic(
    path: Path, robot: Robot, contents: BagContents, settings: ReplaySettings, floats: bool
) -> str:
    """Return the topic of the base's motion, '' where it is at rest."""
    present = [t.name for t in contents.topics if t.type == ODOMETRY and t.messages]
    if settings.base:
        if settings.base not in present:
            raise BagError(
                f'{path}: base must come from a topic of {ODOMETRY} ({_listed(present)}), '
                f'got {settings.base!r}'
            )
        return settings.base
    if not floats:
        return ''
    found = find_topic(present, 'base_motion')
    if not found:
        raise StateError(
            f'replay: the base of {robot.tree.name} must be fixed or its motion recorded '
            f'({ODOMETRY} on base_motion, or another topic given as base), got one that floats '
            f'and {_listed(present)} in {path}'
        )
    return found


def _posture(robot: Robot, found: Mapping[str, str], beginning: JointSeries) -> Array:
    """Return the coordinates of the first messages, 0 where they say nothing."""
    posture = np.zeros(robot.n)
    for name, place in zip(robot.joint_names, robot.joint_indices, strict=True):
        if name in found:
            values = beginning.position[:, beginning.names.index(found[name])]
            known = values[np.isfinite(values)]
            posture[place] = known[0] if len(known) else 0.0
    return posture


def _listed(names: Iterable[str]) -> str:
    return ', '.join(names) or '(none)'
