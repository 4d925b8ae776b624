"""Optional part: the page in the browser, and films; the only importer of viser."""

from __future__ import annotations

from denoc_ros.parts import NodeModules, OptionalPart, Verb

NO_VISER = 'viser must be importable, got: {}; pip install "denoc_ros[viewer]"'

PART = OptionalPart(
    verbs={
        'view': Verb(
            'show a robot or a run in the browser: deformed links, forces, natural modes; write '
            'films',
            'viewer.view_verb',
        )
    },
    nodes={'viewer': NodeModules('viewer.viewer', 'viewer.viewer_parameters')},
)
