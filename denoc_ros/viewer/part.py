"""What the part viewer adds to the core."""

from __future__ import annotations

from denoc_ros.parts import NodeModules, Part, Verb

PART = Part(
    verbs={
        'view': Verb(
            'show a robot or a run in the browser: deformed links, forces, natural modes; write '
            'films',
            'viewer.view_verb',
        )
    },
    nodes={'viewer': NodeModules('viewer.viewer', 'viewer.viewer_parameters')},
)
