"""Optional part: numbers of a robot from recordings: decays, joints, servos, whole models."""

from __future__ import annotations

from denoc_ros.parts import OptionalPart, Verb

PART = OptionalPart(
    names={
        'identify': 'identification.run_numbers',
        'identify_modes': 'identification.decay.modes_fit',
        'design_excitation': 'identification.model.excitation',
        'identify_model': 'identification.model.model_fit',
        'Recording': 'identification.model.sources',
        'ParameterTracker': 'identification.tracking.parameter_tracker',
        'TrackerSettings': 'identification.tracking.tracker_settings',
    },
    verbs={
        'identify': Verb(
            'identify damping and friction from recorded motion',
            'identification.verbs.identify_verb',
            'identification.verbs.actions',
        ),
        'calibrate': Verb(
            "fit a sensor's gain and offset to readings at known references",
            'identification.verbs.calibrate_verb',
        ),
    },
    rows={'predictor': 'identification.tracking.tracker_parameters'},
)
