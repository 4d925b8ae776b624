"""The page of `denoc stability`: the three criteria, and why small errors grow."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from denoc_ros.reports.figures import (
    PHASE_COLOURS,
    TRUTH_COLOUR,
    Curve,
    Figure,
    Panel,
    line_figure,
)
from denoc_ros.reports.pages import Card, PageSection, PageTable, ReportPage, Verdict, engineering
from denoc_ros.simulation.scenario import Scenario
from denoc_ros.simulation.stability import (
    ACCEPTED_DEVIATION,
    ACCEPTED_POWER,
    SOLUTION_METHOD,
    SOLUTION_TOLERANCES,
    Measures,
    Study,
)
from denoc_ros.types import Array

Look = tuple[str, str, bool]  # label, colour, dashed

LOOKS: Mapping[str, Look] = {
    'recursion': ('recursion', PHASE_COLOURS[1], False),
    'cholesky': ('Cholesky', PHASE_COLOURS[0], True),
}
SMALLEST = 1e-17  # what a deviation of zero is drawn as


def page(
    study: Study, scenario: Scenario, subtitle: str, provenance: Mapping[str, str]
) -> ReportPage:
    """Return the page of a study.

    Parameters
    ----------
    study : Study
        What was found.
    scenario : Scenario
        What was studied.
    subtitle : str
        Which robot and scenario.
    provenance : mapping
        What the page was made from and with.
    """
    duration = study.times[-1] - study.times[0]
    step = study.times[1] - study.times[0]
    return ReportPage(
        title='Numerical stability: recursion and Cholesky',
        subtitle=f'{subtitle} · {duration:g} s · {scenario.method}, tolerance '
        f'{scenario.rtol:g}, output every {step:g} s',
        verdict=_verdict(study),
        cards=_cards(study),
        sections=[
            _deviation(study),
            _from_desired(study),
            _power(study),
            _accelerations(study),
            _growth(study),
            _cost(study),
        ],
        provenance=provenance,
    )


def _verdict(study: Study) -> Verdict:
    if study.acceptable:
        text = (
            'The recursion stays with the solution to the end; the algorithms differ by '
            f'{study.difference:.1e} rad or m at most.'
        )
        return Verdict(text)
    least = min(study.runs['recursion'].acceptable)
    return Verdict(f'The recursion stays with the solution only up to {least:.4g} s.', 'doubtful')


def _cards(study: Study) -> list[Card]:
    runs = study.runs.values()
    label = ' / '.join(look[0] for look in LOOKS.values())

    def both(value: Callable[[Measures], str]) -> str:
        return ' / '.join(value(one) for one in runs)

    return [
        Card('Acceptable up to', both(lambda one: f'{min(one.acceptable):.4g} s'), label),
        Card(
            'Largest deviation',
            both(lambda one: f'{np.max(one.deviation):.1e}'),
            f'{label}, rad or m',
        ),
        Card('The algorithms differ by', f'{study.difference:.1e}', 'rad or m, largest'),
        Card(
            'Processor time',
            both(lambda one: engineering(one.trace.seconds, 's')),
            f'{label}, least of some runs',
        ),
    ]


def _curves(study: Study, values: Callable[[Measures], Array]) -> list[Curve]:
    return [
        Curve(label, colour, study.runs[name].trace.t, values(study.runs[name]), dashed)
        for name, (label, colour, dashed) in LOOKS.items()
    ]


def _by_joint(
    study: Study,
    unit: str,
    values: Callable[[Measures, int], Array],
    truth: Array | None = None,
    log: bool = False,
) -> Figure:
    panels = []
    for k, (name, one) in enumerate(zip(study.joint_names, study.joint_units, strict=True)):
        curves = _curves(study, partial(_column, values, k))
        if truth is not None:
            curves.insert(0, Curve('solution', TRUTH_COLOUR, study.solution.t, truth[:, k]))
        panels.append(Panel(name, unit.format(one), curves, log_y=log))
    return line_figure(panels)


def _column(values: Callable[[Measures, int], Array], k: int, one: Measures) -> Array:
    return values(one, k)


def _visible(size: Array) -> Array:
    """Return sizes that a logarithmic axis can show."""
    return np.asarray(np.maximum(size, SMALLEST))


def _deviation(study: Study) -> PageSection:
    right = (
        'the desired motion, which the torques of inverse dynamics make exact'
        if study.exact
        else f'the same equations by {SOLUTION_METHOD} at tolerance {SOLUTION_TOLERANCES[0]:g}'
    )
    head = ['algorithm', *study.joint_names]
    rows = [
        [f'{LOOKS[name][0]}: acceptable up to [s]', *(f'{t:.4g}' for t in one.acceptable)]
        for name, one in study.runs.items()
    ]
    rows += [
        [f'{LOOKS[name][0]}: largest', *(f'{v:.2e}' for v in np.max(one.deviation, axis=0))]
        for name, one in study.runs.items()
    ]
    return PageSection(
        'Zero-eigenvalue deviation',
        f'How far each joint is from the solution: {right}. Accepted up to '
        f'{ACCEPTED_DEVIATION:g} rad or m. Where the curves lie on each other, the error is the '
        "integrator's.",
        [_by_joint(study, '{}', lambda one, k: _visible(one.deviation[:, k]), log=True)],
        [PageTable(head, rows)],
    )


def _from_desired(study: Study) -> PageSection | None:
    if next(iter(study.runs.values())).from_desired is None:
        return None

    def column(one: Measures, k: int) -> Array:
        assert one.from_desired is not None
        return np.asarray(one.from_desired[:, k])

    return PageSection(
        'From the desired motion',
        'Simulated minus desired joints. With flexible links the torques of the rigid robot do '
        'not give the desired motion: most of this is flexibility.',
        [_by_joint(study, '{}', column)],
    )


def _power(study: Study) -> PageSection:
    solution = Curve('solution', TRUTH_COLOUR, study.solution.t, study.power)
    panels = [
        Panel('power of the joints', 'W', [solution]),
        Panel('power difference', 'W', _curves(study, lambda one: one.power_difference)),
    ]
    rows = [
        [
            LOOKS[name][0],
            f'{np.max(np.abs(one.power_difference)):.2e} W',
            f'{one.power_acceptable:.4g} s',
        ]
        for name, one in study.runs.items()
    ]
    return PageSection(
        'Power difference',
        'Torques times the difference of simulated and right rates. Accepted up to '
        f'{100 * ACCEPTED_POWER:g} % of the largest power.',
        [line_figure(panels, height=2.3)],
        [PageTable(['algorithm', 'largest', 'acceptable up to'], rows)],
    )


def _accelerations(study: Study) -> PageSection:
    rows = [
        ['solution', *(f'{value:.3e}' for value in study.solution_roughness)],
        *(
            [LOOKS[name][0], *(f'{value:.3e}' for value in one.roughness)]
            for name, one in study.runs.items()
        ),
    ]
    places = study.joint_indices
    return PageSection(
        'Accelerations',
        'Peaks that the solution does not have would be numerical. Roughness is the root mean '
        "square of the second differences of an output's samples over that of the samples.",
        [
            _by_joint(
                study,
                '{}/s²',
                lambda one, k: np.asarray(one.trace.qdd[:, places[k]]),
                np.asarray(study.solution.qdd[:, places]),
            )
        ],
        [PageTable(['roughness', *study.joint_names], rows)],
    )


def _growth(study: Study) -> PageSection:
    t, colour = study.spectrum_times, LOOKS['recursion'][1]
    panels = [
        Panel('growth of small errors', '%/s', [Curve('', colour, t, 100.0 * study.growth)]),
        Panel('condition number', '', [Curve('', colour, t, study.condition)], log_y=True),
    ]
    return PageSection(
        'What the motion itself does',
        'The largest real part of the eigenvalues of the equations linearized along the solution: '
        'an error grows by this rate whatever the algorithm, as that of an upright pendulum does. '
        'A factorization of the inertia matrix loses at most its condition number times 1e-16.',
        [line_figure(panels, height=2.3)],
    )


def _cost(study: Study) -> PageSection:
    rows = [
        [
            LOOKS[name][0],
            str(one.trace.evaluations),
            engineering(one.trace.seconds, 's'),
            engineering(one.call_seconds, 's'),
            one.trace.failure or 'none',
        ]
        for name, one in study.runs.items()
    ]
    head = ['algorithm', 'evaluations', 'processor time', 'one forward dynamics', 'ended early']
    return PageSection(
        'Cost',
        'Processor time of the whole integration, torques and integrator included, the least of '
        'some runs in turns; and of forward dynamics alone.',
        tables=[PageTable(head, rows)],
    )
