"""Verdict of a run in one sentence, its figures of merit, and its numbers as lines of text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from denoc_ros.bags.run import UNFINISHED
from denoc_ros.model.joint_units import Units
from denoc_ros.pages.html_page import Card, Tone, Verdict, engineering
from denoc_ros.pages.loop_timing import LoopMeasure, NodeWarnings
from denoc_ros.reports.measures import PhaseMeasures, deflection_error, peak, rms
from denoc_ros.reports.sections import without_folders
from denoc_ros.simulation.recorded.run_files import STEPPED
from denoc_ros.units import deflection_unit

WRONG = 20.0  # % of its peak from which on a predicted deflection is no good
OUTDONE = 10.0  # times the tip's error of the best phase: a phase that shows how bad it can get
SMALLEST_ERROR = 1e-4  # m or rad: an error that is less does not matter, whatever it is a share of


def cards(
    phases: Sequence[PhaseMeasures], loops: Sequence[LoopMeasure], units: Units
) -> list[Card]:
    """Return the figures of merit of a run."""
    found: list[Card] = []
    unit = _common(phases, units)
    errors = [(p.name, engineering(worst_joint(p), unit)) for p in phases if p.error is not None]
    found += _of_phases('Joint tracking error, rms of the worst joint', errors, len(phases))
    tips = [(name, engineering(error, 'm')) for name, error in _tip_errors(phases)]
    found += _of_phases('Tip off where it was asked to be, rms while moving', tips, len(phases))
    swings = [(p.name, engineering(peak(p.swing), 'm')) for p in phases if p.swing is not None]
    found += _of_phases('Tip off its goal after the stop, largest', swings, len(phases))
    if percents := _percents(phases):
        worst, name = max(percents)
        found.append(Card('Deflection prediction, worst', f'{worst:.2g} %', f'of peak, {name}'))
    elif bent := _bent(phases):
        size, name = max(bent)
        found.append(Card('Largest deflection', engineering(size, 'm'), name))
    if loops:
        share, node = max((100.0 * loop.late / max(loop.ticks, 1), loop.node) for loop in loops)
        found.append(Card('Late ticks, worst', f'{share:.2g} %', node))
    return found


def _of_phases(label: str, shown: Sequence[tuple[str, str]], count: int) -> list[Card]:
    """Return a card of each phase's value, of the value alone where there is one phase."""
    if count == 1:
        return [Card(label, value) for _, value in shown]
    return [Card(label, rows=shown)] if shown else []


def verdict(
    phases: Sequence[PhaseMeasures],
    warned: Mapping[str, NodeWarnings],
    duration: float,
    units: Units,
    failure: str = '',
    cut: str = '',
) -> Verdict:
    """Return a recorded run in one sentence; warnings and bad predictions make it doubtful.

    A warning in phases that another phase outdoes by far says nothing against the run. The failure
    that has ended a session goes before everything else: it makes the run bad.
    `cut` is the phase that it ended, '' if none.
    """
    if failure:
        return failed(phases, failure, units, cut)
    found = said(phases, units)
    outdone = _outdone(phases)
    # late ticks have a card of their own
    spoke = [
        f'{name} ({", ".join(each.phases)})' if len(phases) > 1 else name
        for name, each in sorted(warned.items())
        if not name.endswith(': loop') and not set(each.phases) <= outdone
    ]
    if spoke:
        found.append(f'nodes warned: {", ".join(spoke)}')
    text = '; '.join(found) or f'{duration:.4g} s are recorded'
    tone: Tone = 'doubtful' if spoke or _wrong(phases) else 'good'
    return Verdict(f'{text[0].upper()}{text[1:]}.', tone)


def failed(phases: Sequence[PhaseMeasures], failure: str, units: Units, cut: str = '') -> Verdict:
    """Verdict of a session that ended early: cause, phase, and the phases before."""
    finished = [phase for phase in phases if not phase.name.endswith(UNFINISHED)]
    where = f' in phase “{cut}”' if cut else ''
    text = f'The session ended{where} before its end: {without_folders(failure.splitlines()[0])}.'
    if found := said(finished, units):
        text += f' Until then: {"; ".join(found)}.'
    elif not finished:
        text += ' No phase was finished.'
    return Verdict(text, 'bad')


def said(phases: Sequence[PhaseMeasures], units: Units) -> list[str]:
    """Return in words how well a run followed and predicted, and how far its links bent."""
    found = []
    errors = [(worst_joint(p), p.name) for p in phases if p.error is not None]
    if tips := _tip_errors(phases):
        told = [f'{engineering(error, "m")} ({name})' for name, error in tips]
        if len(phases) == 1:
            told = [engineering(tips[0][1], 'm')]
        listed = ', '.join(told[:-1]) + (' and ' if told[1:] else '') + told[-1]
        found.append(f'while it moves, the tip is off where it was asked to be by {listed} rms')
    elif errors:
        (least, name), unit = min(errors), _common(phases, units)
        which = f' ({name})' if len(errors) > 1 else ''
        found.append(f'joints follow their reference to {engineering(least, unit)} rms{which}')
    if swings := [(peak(p.swing), p.name) for p in phases if p.swing is not None]:
        least, name = min(swings)
        which = f' ({name})' if len(swings) > 1 else ''
        found.append(f'the tip stops within {engineering(least, "m")} of its goal{which}')
    if wrong := _wrong(phases):
        found.append(f'the predicted deflection is wrong by {wrong}')
    elif percents := _percents(phases):
        found.append(f'deflection is predicted to {max(percents)[0]:.2g} % of its peak or better')
    elif bent := _bent(phases):
        size, name = max(bent)
        found.append(f'links deflect by up to {engineering(size, "m")} ({name})')
    return found


def worst_joint(phase: PhaseMeasures) -> float:
    """Return the rms tracking error of a phase's worst joint [rad, m]."""
    assert phase.error is not None
    return max(map(rms, phase.error.values.T))


def _tip_errors(phases: Sequence[PhaseMeasures]) -> list[tuple[str, float]]:
    """Return the names of phases and how far the tip is off [m], rms while it moves."""
    found = [(p.name, p.tip_error.values if p.moving is None else p.moving) for p in phases
             if p.tip_error is not None]  # fmt: skip
    return [(name, rms(values)) for name, values in found]


def _outdone(phases: Sequence[PhaseMeasures]) -> set[str]:
    """Return the phases with `OUTDONE` times the tip's error of the best one."""
    errors = _tip_errors(phases)
    least = min((error for _, error in errors), default=0.0)
    return {name for name, error in errors if error > OUTDONE * least}


def _bent(phases: Sequence[PhaseMeasures]) -> list[tuple[float, str]]:
    """Peaks of the true deflections along a line [m]."""
    entries = [entry for phase in phases for entry in phase.deflections if entry.unit == 'm']
    return [(peak(entry.true), entry.name) for entry in entries if entry.true is not None]


def _common(phases: Sequence[PhaseMeasures], units: Units) -> str:
    """Return the unit of all joints' errors together."""
    names = (name for p in phases if p.error is not None for name in p.error.names)
    return ' or '.join(sorted({units.position(name) for name in names}, reverse=True))


def _percents(phases: Sequence[PhaseMeasures]) -> list[tuple[float, str]]:
    errors = [(deflection_error(entry), entry) for phase in phases for entry in phase.deflections]
    return [(error['percent_of_peak'], entry.name) for error, entry in errors if error is not None]


def _wrong(phases: Sequence[PhaseMeasures]) -> str:
    """Return the worst of the predictions that are no good, in words; '' if all are good."""
    found = []
    for phase in phases:
        for entry in phase.deflections:
            error = deflection_error(entry)
            if error and error['rms'] > SMALLEST_ERROR and error['percent_of_peak'] > WRONG:
                which = f'{entry.name}, {phase.name}' if len(phases) > 1 else entry.name
                found.append((error['percent_of_peak'], which))
    return f'{max(found)[0]:.2g} % of its peak ({max(found)[1]})' if found else ''


def time_in_words(time: Mapping[str, Any]) -> str:
    """Return by which time a session ran, why and how fast; '' for one that does not say.

    Parameters
    ----------
    time : mapping
        `mode`, `why` and `factor` of its session.json.
    """
    why, factor = str(time.get('why', '')), time.get('factor')
    if time.get('mode') != STEPPED or not isinstance(factor, float):
        return why
    return f'{why}; the phases ran at {factor:.2g} times real time'


def summary_lines(summary: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines: tracking by phase, deflection by link, loops, recording."""
    if words := time_in_words(summary.get('time', {})):
        yield f'time    {words}'
    for note in summary.get('notes', ()):
        yield f'note    {note}'
    phases = summary['phases']
    for name, phase in phases.items():
        if 'joint_error' in phase:
            errors = phase['joint_error'].items()
            joints = ', '.join(f'{j} {engineering(e["rms"], "rad")}' for j, e in errors)
            yield f'{name}: joint tracking error rms {joints}'
        if 'tip_error_moving' in phase:
            moving, after = phase['tip_error_moving'], phase['tip_error_after_stop']
            settled = phase.get('tip_error_settled')
            yield (
                f'{name}: tip off where it was asked to be by {engineering(moving["rms"], "m")} '
                f'rms while moving, {engineering(after["max"], "m")} at most after the stop'
                + (f', {engineering(settled["max"], "m")} from 3 s after it' if settled else '')
            )
        elif 'tip_error' in phase:
            tip = phase['tip_error']
            yield (
                f'{name}: tip tracking error rms {engineering(tip["rms"], "m")}, '
                f'largest {engineering(tip["max"], "m")}'
            )
    for name, phase in phases.items():
        for where, error in phase.get('deflection_error', {}).items():
            unit = deflection_unit(where)
            yield (
                f'{name}: {where} predicted to {engineering(error["rms"], unit)} rms of a peak of '
                f'{engineering(error["peak"], unit)} ({error["percent_of_peak"]:.2g} %)'
            )
    for node, loop in summary['loops'].items():
        yield (
            f'{node}: {loop["ticks"]} ticks at {1.0 / loop["nominal"]:g} Hz, '
            f'{100.0 * loop["late"] / max(loop["ticks"], 1):.2g} % late by more than half a period'
        )
    for name, (times, text, within) in sorted(summary.get('warnings', {}).items()):
        if not name.endswith(': loop'):
            yield f'warning {name}: {text} ({times} times; {", ".join(within)})'
    if shares := summary.get('processor_share'):
        listed = ', '.join(f'{node} {100.0 * share:.0f} %' for node, share in shares.items())
        yield f'share of a core: {listed}'
    if recorder := summary.get('recorder'):
        yield f'recorded: {sum(summary["messages"].values())} messages, {recorder["lost"]} lost'
