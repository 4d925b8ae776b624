"""Units of the joints of a robot, for numbers that people read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from denoc_ros.model.tree import JointKind, Tree


@dataclass(frozen=True)
class Units:
    """Units of joints by their names; those of joints that are not known turn."""

    kinds: Mapping[str, JointKind] = field(default_factory=dict)

    @classmethod
    def of(cls, tree: Tree | None) -> Units:
        """Return those of a robot's joints."""
        joints = {} if tree is None else tree.joints
        return cls({name: joint.kind for name, joint in joints.items()})

    def position(self, joint: str) -> str:
        """Return that of its position."""
        return self.kinds.get(joint, JointKind.REVOLUTE).unit

    def effort(self, joint: str) -> str:
        """Return that of its force or torque."""
        return self.kinds.get(joint, JointKind.REVOLUTE).effort_unit
