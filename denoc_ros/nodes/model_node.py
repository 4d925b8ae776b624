"""A node that holds a robot's model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from std_msgs.msg import String

from denoc_ros.dynamics.measured_side import measured_robot
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import ConfigError, ModelError
from denoc_ros.model.numbers import FAMILIES
from denoc_ros.model.overrides import with_held_base
from denoc_ros.model.source import is_text, parse_xml
from denoc_ros.nodes.base import LATCHED, DenocNode
from denoc_ros.runtime.input_error import InputError
from denoc_ros.runtime.input_monitor import InputMonitor
from denoc_ros.runtime.live_model import LiveModel
from denoc_ros.runtime.parameters import ParameterTable, Settings, Value
from denoc_ros.types import Array


class ModelNode(DenocNode):
    """Loads the robot on configure, from a file or from the topic robot_description.

    A node overrides `prepare`: build all that it makes of the robot.

    Attributes
    ----------
    robot : Robot
        The node's own, with the overrides of the parameters.
    model : LiveModel or None
        What the robot is made from; None until the node is configured.
    floating : LiveModel or None
        The robot with its floating base, where the node's own has it held.
    description : str
        What robot_description last said.
    sees_joint_states : bool
        Whether the robot is the one that joint states describe: without the springs behind which
        joints are measured.
    """

    robot: Robot
    sees_joint_states = False

    def __init__(self, name: str, table: ParameterTable, **options: Any) -> None:
        super().__init__(name, table, **options)
        self.model: LiveModel | None = None
        self.floating: LiveModel | None = None
        self.description = ''
        self.add_post_set_parameters_callback(self._after_parameters)
        if not self.settings.text('urdf_path'):
            self.ready = False
            self._description_input = InputMonitor('robot_description')
            self.monitors.append(self._description_input)
            self.create_subscription(
                String, 'robot_description', self._on_description, LATCHED, raw=False
            )

    def _on_description(self, message: String) -> None:
        monitor = self._description_input
        try:
            check_description(monitor.topic, message.data)
        except InputError as error:
            self.refuse(monitor, error)
            return
        monitor.accept(None, self.clock.now())
        self.description = message.data
        self.ready = True

    def prepare(self) -> None:
        """Build from `self.robot` all that the node uses."""

    def read_model(self, settings: Settings) -> LiveModel:
        """Return the robot of the file or topic, to be changed by overrides.

        Raises
        ------
        ModelError
            The description does not give a model; every finding.
        ConfigError
            There is none, or gravity has not three elements.
        """
        source = settings.text('urdf_path') or self.description
        gravity = settings.numbers('gravity')
        name = self.get_fully_qualified_name()
        if not source:
            raise ConfigError(
                name, ["parameter 'urdf_path' or the topic robot_description must give the robot"]
            )
        if len(gravity) != 3:
            raise ConfigError(name, [f"parameter 'gravity' must have 3 elements, got {gravity}"])
        options: dict[str, Any] = {
            'gravity': tuple(gravity),
            'geometric_stiffness': settings.flag('geometric_stiffness'),
        }
        robot = self.described(load_robot(source, **options), settings)
        if len(robot.base_indices) and self.holds_base:
            self.floating = LiveModel(self._seen(robot), name)
            robot = load_robot(with_held_base(robot.tree.source), **options)
        return LiveModel(self._seen(robot), name)

    def described(self, robot: Robot, settings: Settings) -> Robot:
        """Return the robot as the node describes its beams: here as it was loaded."""
        del settings
        return robot

    def _seen(self, robot: Robot) -> Robot:
        return measured_robot(robot) if self.sees_joint_states else robot

    @property
    def holds_base(self) -> bool:
        """Whether a floating base counts as one whose motion is known."""
        return False

    def adopt_model(self, model: LiveModel, settings: Settings) -> None:
        """Adopt a model for the overrides to change, and list them."""
        self.model = model
        overrides = model.plain(settings.family(*FAMILIES))
        self.settings = settings.without(*FAMILIES).replace(overrides)
        self.show(model.values(overrides))

    def changed_robot(self, settings: Settings, model: LiveModel | None = None) -> Robot:
        """Return a robot of its own with the overrides of `settings`, by default of `self.model`.

        Raises
        ------
        ConfigError, ModelError
            A path that names nothing, or a value that makes no model.
        """
        model = self.model if model is None else model
        assert model is not None
        return model.robot(settings.family(*FAMILIES))

    def posture(self, robot: Robot, settings: Settings) -> Array:
        """Return the coordinates (n,) near which the robot's loops are closed.

        Raises
        ------
        ConfigError
            The parameter has another number of elements than the robot has joints.
        """
        given = settings.numbers('posture')
        count = len(robot.joint_names)
        if given and len(given) != count:
            raise ConfigError(
                self.get_fully_qualified_name(),
                [
                    f"parameter 'posture' must have an element for each of the {count} joints "
                    f'{list(robot.joint_names)}, got {len(given)}'
                ],
            )
        q = np.zeros(robot.n)
        q[robot.joint_indices] = given or 0.0
        return q

    def require_configured(self, why: str) -> None:
        """Refuse a request that needs a robot while there is none.

        Raises
        ------
        ConfigError
            The node is not configured.
        """
        if self.state not in ('active', 'inactive'):
            raise ConfigError(self.get_name(), [f'the node must be configured {why}'])

    def require_coordinates(self, robot: Robot) -> None:
        """Refuse a changed robot that has other coordinates.

        Raises
        ------
        ConfigError
            With the coordinates it has.
        """
        if tuple(robot.coordinate_names) != tuple(self.robot.coordinate_names):
            raise ConfigError(
                self.get_fully_qualified_name(),
                [f'the robot must keep its coordinates, got {list(robot.coordinate_names)}'],
            )

    def require_joints(self, robot: Robot) -> None:
        """Refuse a changed robot that has other joints.

        Raises
        ------
        ConfigError
            With the joints it has.
        """
        if tuple(robot.joint_names) != tuple(self.robot.joint_names):
            rule = f'joints must stay {list(self.robot.joint_names)} on reload'
            got = f'(clean up and configure instead), got {list(robot.joint_names)}'
            raise ConfigError(self.get_name(), [f'{rule} {got}'])

    def plain(self, changes: dict[str, Value]) -> dict[str, Value]:
        """Return changes with overrides under their own paths."""
        return changes if self.model is None else self.model.plain(changes)

    def _after_parameters(self, parameters: Sequence[Any]) -> None:
        """Report the effects of a changed override: its other name, and dependent parameters."""
        changed = any(is_override(parameter.name) for parameter in parameters)
        if changed and self.model is not None and not self._showing:
            self.show(self.model.values(self.settings.family(*FAMILIES)))

    def configure(self) -> None:
        """Load the robot, then build the node's objects."""
        try:
            model = self.read_model(self.settings)
        except ModelError:  # a topic may say another one
            self.ready = bool(self.settings.text('urdf_path'))
            raise
        self.robot = self.changed_robot(self.settings, model)
        self.adopt_model(model, self.settings)
        for warning in self.robot.tree.warnings:
            self.get_logger().warning(warning)
        self.prepare()


def check_description(topic: str, text: str) -> None:
    """Refuse text that is not a description: a path from a topic is never opened.

    Raises
    ------
    InputError
        Cause `format`: the text is not the XML of a `<robot>`.
    """
    if not is_text(text):
        got = f'{len(text)} characters that begin with {text[:20]!r}'
        raise InputError('format', f'{topic} must be the XML of a <robot>, got {got}')
    try:
        parse_xml(topic, text)
    except ModelError as error:
        raise InputError('format', str(error)) from error


def is_override(name: str) -> bool:
    """Say whether a parameter changes the model."""
    return name.split('.')[0] in FAMILIES and '.' in name


def driven_joints(robot: Robot, given: Sequence[str], where: str) -> list[str]:
    """Return the joints a node works on: those `given`, else all that are not mimics.

    Raises
    ------
    ConfigError
        A given one is not the robot's, repeated or a mimic joint; none is given for a robot with
        loops.
    """
    if robot.tree.loops and not given:
        rule = "parameter 'joints' must name the driven joints of a robot with loops"
        raise ConfigError(where, [f'{rule}, some of {list(robot.joint_names)}, got none'])
    free = list(robot.tree.non_mimic_joints)
    wrong = [name for name in given if name not in free]
    if wrong or len(set(given)) != len(given):
        raise ConfigError(
            where,
            [f"parameter 'joints' must name different joints of {free}, got {list(given)}"],
        )
    return list(given) or free
