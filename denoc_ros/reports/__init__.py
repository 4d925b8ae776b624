"""Optional part: HTML pages of runs, and their numbers."""

from __future__ import annotations

from denoc_ros.parts import OptionalPart, Verb

PART = OptionalPart(
    names={'report': 'reports.run_page'},
    verbs={'report': Verb('write the HTML report of a run or of any bag', 'reports.report_verb')},
)
