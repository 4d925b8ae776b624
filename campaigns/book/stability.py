"""The recursion beside dense Cholesky, by three criteria."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from book.stability_study import (
    ACCEPTED_DEVIATION,
    ACCEPTED_POWER,
    SOLUTION_METHOD,
    SOLUTION_TOLERANCES,
    Measures,
    Study,
    study_stability,
)

from denoc_ros.cli.arguments import add_json, add_option, add_output, given_file
from denoc_ros.cli.progress import share_bar
from denoc_ros.cli.simulate_verb import load
from denoc_ros.cli.verb_result import VerbResult
from denoc_ros.cli.verbs import DOUBTFUL
from denoc_ros.output_files import write_text
from denoc_ros.pages.figures import Curve, Figure, Ink, Panel, line_figure
from denoc_ros.pages.html_page import (
    Card,
    PageSection,
    PageTable,
    ReportPage,
    Verdict,
    engineering,
)
from denoc_ros.pages.provenance import named_file, provenance
from denoc_ros.simulation.scenario import Scenario
from denoc_ros.types import Array

DESCRIPTION = (
    'Integrate a scenario twice, with forward dynamics by the recursion and by a Cholesky '
    'factor of the inertia matrix, and write one HTML page: deviation, power difference and '
    "roughness of the accelerations (the book's section 7.1), processor times, and the growth "
    'rate of small errors in the motion itself. Exit status 2: the recursion leaves the '
    'solution before the end.'
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_option(parser, 'robot', 'the URDF file')
    add_option(
        parser, 'scenario', 'a YAML file with torques, such as config/scenarios/stability_*.yaml'
    )
    text = 'file of the page; default: stability.html here'
    add_output(parser, 'FILE', text, default=Path('stability.html'))
    add_json(parser)


def run(args: argparse.Namespace) -> VerbResult:
    """Study the scenario and write the page; errors are raised."""
    robot, scenario, _ = load(args.robot, args.scenario)
    with share_bar(quiet=args.json) as bar:
        study = study_stability(robot, scenario, bar.update)
    summary = summarize(study, scenario)
    names = {'robot': Path(args.robot).name, 'scenario': Path(args.scenario).name}
    given = ((name, given_file(getattr(args, name), name)) for name in names)
    made = provenance(args.command, {name: named_file(file) for name, file in given})
    shown = page(study, scenario, ' · '.join(names.values()), made)
    write_text(args.output, shown.html())
    named = {'output': str(args.output), **names, **summary}
    return VerbResult(named, _lines(named), 0 if study.acceptable else DOUBTFUL)


def summarize(study: Study, scenario: Scenario) -> dict[str, Any]:
    """Return a study's figures, ready for JSON: times in s, deviations in rad or m, powers in W"""
    growing = int(np.argmax(study.growth))
    return {
        'duration_s': float(study.times[-1]),
        'method': scenario.method,
        'tolerance': scenario.rtol,
        'acceptable': study.acceptable,
        'algorithms': {name: _figures(study, one) for name, one in study.runs.items()},
        'largest_power_W': float(np.max(np.abs(study.power))),
        'solution': 'desired motion' if study.exact else 'integrated at 1e-12',
        'solution_roughness': _by_joint(study, study.solution_roughness),
        'difference_of_algorithms': study.difference,
        'difference_at_solution_tolerance': study.fine_difference,
        'largest_growth_per_s': float(study.growth[growing]),
        'largest_growth_at_s': float(study.spectrum_times[growing]),
        'largest_condition_number': float(np.max(study.condition)),
    }


def _figures(study: Study, one: Measures) -> dict[str, Any]:
    trace = one.trace
    figures = {
        'reached_s': float(trace.t[-1]),
        'failure': trace.failure,
        'processor_s': trace.seconds,
        'evaluations': trace.evaluations,
        'forward_dynamics_us': 1e6 * one.call_seconds,
        'acceptable_s': _by_joint(study, one.acceptable),
        'largest_deviation': _by_joint(study, np.max(one.deviation, axis=0)),
        'largest_power_difference_W': float(np.max(np.abs(one.power_difference))),
        'power_acceptable_s': one.power_acceptable,
        'roughness': _by_joint(study, one.roughness),
    }
    if one.from_desired is not None:
        largest = np.max(np.abs(one.from_desired), axis=0)
        figures['largest_difference_from_desired'] = _by_joint(study, largest)
    return figures


def _by_joint(study: Study, values: Any) -> dict[str, float]:
    return {name: float(value) for name, value in zip(study.joint_names, values, strict=True)}


def _lines(summary: Mapping[str, Any]) -> Iterator[str]:
    runs = summary['algorithms'].items()
    yield (
        f'{summary["output"]}: {summary["duration_s"]:g} s, {summary["method"]}, '
        f'tolerance {summary["tolerance"]:g}'
    )
    for name, one in runs:
        accepted = min(one['acceptable_s'].values())
        deviation = max(one['largest_deviation'].values())
        yield (
            f'  {name}: acceptable to {accepted:.4g} s, largest deviation {deviation:.2g}, power '
            f'difference {one["largest_power_difference_W"]:.2g} of '
            f'{summary["largest_power_W"]:.3g} W, {one["evaluations"]} evaluations, '
            f'{one["processor_s"]:.3g} s of processor, forward dynamics '
            f'{one["forward_dynamics_us"]:.3g} us'
        )
        if one['failure']:
            yield f'    {one["failure"]}'
    yield (
        f'  algorithms differ by {summary["difference_of_algorithms"]:.2g}; small errors grow at '
        f'up to {summary["largest_growth_per_s"]:.3g} /s (t = '
        f'{summary["largest_growth_at_s"]:.3g} s); condition number up to '
        f'{summary["largest_condition_number"]:.3g}'
    )


Look = tuple[str, str, bool]  # label, colour, dashed

LOOKS: Mapping[str, Look] = {
    'recursion': ('recursion', Ink.PHASES[1], False),
    'cholesky': ('Cholesky', Ink.PHASES[0], True),
}
SMALLEST = 1e-17  # what a deviation of zero is drawn as


def page(
    study: Study, scenario: Scenario, subtitle: str, provenance: Mapping[str, str]
) -> ReportPage:
    """Return the page of a study."""
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


def _curves(study: Study, values: Callable[..., Array], *joint: int) -> list[Curve]:
    return [
        Curve(label, colour, study.runs[name].trace.t, values(study.runs[name], *joint), dashed)
        for name, (label, colour, dashed) in LOOKS.items()
    ]


def _joint_panels(
    study: Study,
    unit: str,
    values: Callable[[Measures, int], Array],
    truth: Array | None = None,
    log: bool = False,
) -> Figure:
    panels = []
    for k, (name, one) in enumerate(zip(study.joint_names, study.joint_units, strict=True)):
        curves = _curves(study, values, k)
        if truth is not None:
            curves.insert(0, Curve('solution', Ink.TRUTH, study.solution.t, truth[:, k]))
        panels.append(Panel(name, unit.format(one), curves, log_y=log))
    return line_figure(panels)


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
        [
            _joint_panels(
                study, '{}', lambda one, k: np.maximum(one.deviation[:, k], SMALLEST), log=True
            )
        ],
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
        [_joint_panels(study, '{}', column)],
    )


def _power(study: Study) -> PageSection:
    solution = Curve('solution', Ink.TRUTH, study.solution.t, study.power)
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
            _joint_panels(
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
