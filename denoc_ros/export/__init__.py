"""Optional part: a robot as the model of another simulator."""

from __future__ import annotations

from denoc_ros.parts import Part, Verb

PART = Part(
    verbs={
        'export': Verb(
            "write a robot as MuJoCo's or Gazebo's model, beams as chains of sprung rods",
            'export.export_verb',
        )
    },
)
