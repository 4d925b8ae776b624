"""Optional part: feedback of joints and sensors about a planned motion."""

from __future__ import annotations

from denoc_ros.parts import OptionalPart

PART = OptionalPart(
    # errors of the model change the plan of the tip
    needs=('planning',),
    jobs={'gains': 'feedback.gain_jobs'},
    rows={'feedforward': 'feedback.feedback_parameters'},
)
