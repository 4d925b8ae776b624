"""What the part planning adds to the core."""

from __future__ import annotations

from denoc_ros.parts import NodeModules, Part, Verb

PART = Part(
    names={'shape_motion': 'planning.shape_motion'},
    verbs={
        'shape': Verb(
            'plan a motion without residual vibration, with the tip on its path',
            'planning.shape_verb',
        )
    },
    nodes={'shaper': NodeModules('planning.shaper', 'planning.shaper_parameters')},
    jobs={'motion': 'planning.planner_process'},
)
