"""Optional part: plans of motions without residual vibration."""

from __future__ import annotations

from denoc_ros.parts import NodeModules, OptionalPart, Verb

PART = OptionalPart(
    names={'shape_motion': 'planning.shape_motion'},
    verbs={
        'shape': Verb(
            'plan a motion without residual vibration, with the tip on its path',
            'planning.shape_verb',
        )
    },
    nodes={'shaper': NodeModules('planning.shaper', 'planning.shaper_parameters')},
    jobs={'load': 'planning.plan_jobs', 'shape': 'planning.plan_jobs'},
)
