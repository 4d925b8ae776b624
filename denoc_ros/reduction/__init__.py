"""Optional part: flexible links from meshes, matrices of other programs, or a plain URDF."""

from __future__ import annotations

from denoc_ros.parts import OptionalPart, Verb

PART = OptionalPart(
    names={'suggest_flexibility': 'reduction.suggest.suggestion'},
    verbs={
        'reduce': Verb(
            "reduce a link from its mesh, or another program's matrices, to a few modes",
            'reduction.reduce_verb',
        )
    },
)
