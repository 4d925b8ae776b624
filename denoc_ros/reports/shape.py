"""The page of `denoc shape`: tip error before and after, joints, torque, wrong models."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from denoc_ros.control.plan import LimitUse, Plan
from denoc_ros.model.tree import Tree
from denoc_ros.reports.figures import DIFFERENCE_COLOUR, PHASE_COLOURS, Curve, Panel, line_figure
from denoc_ros.reports.pages import Card, PageSection, PageTable, ReportPage, Verdict, engineering
from denoc_ros.reports.sections import Units
from denoc_ros.reports.shape_comparison import PlanComparison, Tracked

TITLES = {'tip': 'The tip goes where it should'}
PLAIN, SHAPED = 'as it was asked for', 'as it was planned'
HEIGHT = 2.4  # inches
WORSE = 1.0  # times the plain motion's swing: a plan that leaves more is doubtful


def page(found: PlanComparison, tree: Tree, provenance: Mapping[str, str]) -> ReportPage:
    """Return the page.

    Parameters
    ----------
    found : PlanComparison
    tree : Tree
        Of the robot.
    provenance : mapping
        What the page was made from and with.
    """
    plan, units = found.plan, Units.of(tree)
    return ReportPage(
        title=TITLES.get(plan.method, 'A motion without swing'),
        subtitle=f'{tree.name} · method {plan.method} · frame {found.frame}',
        verdict=_verdict(found),
        cards=_cards(found),
        sections=[
            _tip(found),
            _joints(found, units),
            _torque(found, units),
            _models(found) if found.variations else None,
            _method(found),
        ],
        provenance=provenance,
    )


def _verdict(found: PlanComparison) -> Verdict:
    plain, shaped = found.plain, found.shaped
    text = (
        f'The tip strays by {engineering(shaped.rms, "m")} rms while it moves, where the motion '
        f'as it was asked for makes it stray by {engineering(plain.rms, "m")}; after the stop it '
        f'swings by {engineering(shaped.swing, "m")}, where it would by '
        f'{engineering(plain.swing, "m")}.'
    )
    worst = max([one.shaped.swing for one in found.variations], default=shaped.swing)
    return Verdict(text, 'good' if worst <= WORSE * plain.swing else 'doubtful')


def _cards(found: PlanComparison) -> list[Card]:
    plan = found.plan

    def arrow(what: str) -> str:
        values = (getattr(found.plain, what), getattr(found.shaped, what))
        return ' → '.join(engineering(value, 'm') for value in values)

    cards = [
        Card('Tip off while moving, rms', arrow('rms'), f'{PLAIN} → {SHAPED}'),
        Card('Swing after the stop', arrow('swing'), 'from where it comes to rest'),
        Card('Joints move before', engineering(plan.preaction, 's')),
        Card('Joints move after', engineering(plan.postaction, 's')),
    ]
    if plan.passed is not None:
        cards.append(Card('Time, of that asked for', f'{plan.stretch:.4g}', 'least within limits'))
    elif plan.stretch > 1.0:
        cards.append(Card('Slower by', f'{plan.stretch:.4g}', 'to keep the limits'))
    if plan.delay > 0.0:
        cards.append(Card('Arrives later by', engineering(plan.delay, 's')))
    return cards


def _tip(found: PlanComparison) -> PageSection:
    pairs = zip((PLAIN, SHAPED), PHASE_COLOURS, (found.plain, found.shaped), strict=False)
    curves = [Curve(name, colour, run.t, run.error) for name, colour, run in pairs]
    logarithmic = [
        Curve(c.label, c.colour, c.t, np.maximum(c.y, 1e-3 * _smallest(found))) for c in curves
    ]
    figure = line_figure(
        [
            Panel('Tip off what was asked', 'm', curves),
            Panel('The same, logarithmic', 'm', logarithmic, log_y=True),
        ],
        HEIGHT,
    )
    text = (
        'Where the tip is, off where the undeformed robot on the motion that was asked for would '
        'have it; simulated on this model, the joints exactly on either motion.'
    )
    return PageSection('The tip', text, [figure])


def _smallest(found: PlanComparison) -> float:
    """Lower end of a logarithmic figure [m]."""
    return max(1e-9, min(found.plain.rms, found.shaped.rms))


def _joints(found: PlanComparison, units: Units) -> PageSection:
    plan = found.plan
    columns = [plan.coordinate_names.index(name) for name in plan.joint_names]
    panels = []
    for k, (name, column) in enumerate(zip(plan.joint_names, columns, strict=True)):
        before = Curve(PLAIN, PHASE_COLOURS[0], plan.t, found.asked[:, k], dashed=True)
        after = Curve(SHAPED, PHASE_COLOURS[1], plan.t, plan.q[:, column])
        apart = Curve(
            'difference', DIFFERENCE_COLOUR, plan.t, plan.q[:, column] - found.asked[:, k]
        )
        panels += [
            Panel(name, units.position(name), [before, after]),
            Panel(f'{name}: planned − asked', units.position(name), [apart]),
        ]
    text = 'What the joints do so that the tip does what was asked.'
    return PageSection('Joints', text, [line_figure(panels)])


def _torque(found: PlanComparison, units: Units) -> PageSection:
    plan = found.plan
    panels = [
        Panel(name, units.effort(name), [Curve(SHAPED, PHASE_COLOURS[1], plan.t, column)])
        for name, column in zip(plan.joint_names, plan.torque.T, strict=True)
    ]
    figures = [line_figure(panels)]
    text = 'What the joints need for it, on this model.'
    use, tables = plan.limits, []
    if use is not None and use.names:
        text += ' Below, how much of its limits the plan uses at each instant, and which binds.'
        figures.append(line_figure([Panel('Largest share of a limit', '', _binding(plan, use))]))
        most = use.largest
        head = ['limit', 'largest share', 'time gained by 1 % more']
        used = sorted(most, key=lambda name: (-use.gains.get(name, 0.0), -most[name]))
        tables = [
            PageTable(
                head,
                [
                    [name, f'{most[name]:.3f}', f'{100.0 * use.gains.get(name, 0.0):.2f} %']
                    for name in used
                ],
            )
        ]
    return PageSection('Torque', text, figures, tables=tables)


def _binding(plan: Plan, use: LimitUse) -> list[Curve]:
    """Return the strip: the largest share in grey, and a colour for each limit where it binds."""
    largest = use.shares.max(axis=1)
    curves = [Curve('largest share', DIFFERENCE_COLOUR, plan.t, largest)]
    binds = np.array(use.binding())
    often = sorted({name for name in binds if name}, key=lambda name: -(binds == name).sum())
    for name, colour in zip(often, PHASE_COLOURS, strict=False):
        curves.append(Curve(name, colour, plan.t, np.where(binds == name, largest, np.nan)))
    return curves


def _models(found: PlanComparison) -> PageSection:
    head = ['model', 'moving, rms', 'swing after', 'swing after, motion as asked']
    rows = [_row('as it is', found.plain, found.shaped)]
    rows += [_row(one.name, one.plain, one.shaped) for one in found.variations]
    text = (
        'The same plan, joints exactly on it, on models that are off by 20 % in one number each: '
        'what to expect of a real robot. Where this is too much, state feedback or an input '
        'shaper is the better choice.'
    )
    return PageSection('If the model is off', text, tables=[PageTable(head, rows)])


def _row(name: str, plain: Tracked, shaped: Tracked) -> list[str]:
    values = (shaped.rms, shaped.swing, plain.swing)
    return [name, *(engineering(value, 'm') for value in values)]


def _method(found: PlanComparison) -> PageSection:
    left = engineering(found.plan.equation_error, 'm')
    text = (
        'Joints and links are planned together over the whole time: the equations of motion of '
        'the links hold at every instant, and the tip is where it should be as nearly as they '
        'allow (docs/control.md). Between the nodes of its grid the plan leaves forces without '
        f'an actuator that would bend a link by {left} rms.'
        if found.plan.method == 'tip'
        else 'Input shapers and motions from rest to rest: docs/control.md.'
    )
    return PageSection('How this is worked out', text)
