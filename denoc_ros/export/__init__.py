"""Optional part: a robot as the model of another simulator."""

from __future__ import annotations

from denoc_ros.parts import OptionalPart, Verb

PART = OptionalPart(
    verbs={
        'export': Verb(
            "write a robot as MuJoCo's or Gazebo's model, beams as chains of sprung rods",
            'export.export_verb',
        ),
        'dh': Verb(
            'make a URDF with flexible links from a Denavit-Hartenberg table', 'export.dh_verb'
        ),
    },
)
