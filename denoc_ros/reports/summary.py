"""A run's numbers as lines of text for the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from denoc_ros.reports.pages import engineering
from denoc_ros.reports.run_files import STEPPED


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
    """Yield the lines: tracking by phase, deflection by link, loops, recording.

    Parameters
    ----------
    summary : mapping
        Of :class:`denoc_ros.reports.run.Report`.
    """
    if words := time_in_words(summary.get('time', {})):
        yield f'time    {words}'
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
            unit = 'rad' if where.rpartition('/')[2].startswith('r') else 'm'
            yield (
                f'{name}: {where} predicted to {engineering(error["rms"], unit)} rms of a peak of '
                f'{engineering(error["peak"], unit)} ({error["percent_of_peak"]:.2g} %)'
            )
    for node, loop in summary['loops'].items():
        yield (
            f'{node}: {loop["ticks"]} ticks at {1.0 / loop["nominal"]:g} Hz, '
            f'{100.0 * loop["late"] / max(loop["ticks"], 1):.2g} % late by more than half a period'
        )
    for name, (count, text) in sorted(summary.get('warnings', {}).items()):
        if not name.endswith(': loop'):
            yield f'warning {name}: {text} ({count} times)'
    if shares := summary.get('processor_share'):
        listed = ', '.join(f'{node} {100.0 * share:.0f} %' for node, share in shares.items())
        yield f'share of a core: {listed}'
    if recorder := summary.get('recorder'):
        yield f'recorded: {sum(summary["messages"].values())} messages, {recorder["lost"]} lost'
