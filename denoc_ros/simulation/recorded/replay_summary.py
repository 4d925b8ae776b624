"""A replay's numbers as plain mappings, ready for JSON; unknown numbers are None."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from denoc_ros.output_files import plain
from denoc_ros.simulation.recorded.adapted import NORMAL, Adapted
from denoc_ros.simulation.recorded.agreement import Agreement
from denoc_ros.simulation.recorded.compared import Compared
from denoc_ros.simulation.recorded.plausibility import effort_doubts, jump_doubts
from denoc_ros.simulation.recorded.replay_bag import Replay
from denoc_ros.simulation.recorded.residual_friction import TERMS, FrictionFit

UNKNOWN = '–'
SAMPLES = 2000  # of a number over time, at most
FEW = 0.01  # of all joint states may be left out, of a torque count for nothing
FAR = 2.0  # standard errors below zero are no chance


def summarize(replay: Replay) -> dict[str, Any]:
    """Return input and result of a replay: SI units, by joint and by deflection."""
    joints = replay.plan.joints
    return {
        'bag': str(replay.plan.source.path),
        'joint_states': replay.plan.source.topic,
        'effort': replay.plan.effort or replay.plan.source.topic,
        'derivative': replay.settings.derivative,
        'cutoff_hz': replay.cutoff,
        'period_s': replay.period,
        'joints': list(joints),
        'held_joints': list(replay.held),
        'ignored_joints': list(replay.plan.ignored),
        **_compared(replay, replay),
        'friction': None if replay.friction is None else _friction(joints, replay.friction),
        'adapted': None if replay.adapted is None else _adapted(replay.adapted),
        'phases': {
            one.name: {
                'begin_s': one.begin,
                **_compared(replay, one),
                'plant': {
                    path: {'plant': plant, 'model': model}
                    for path, (plant, model) in one.plant.items()
                },
                'doubts': doubts_of(joints, one),
            }
            for one in replay.phases
        },
        'notes': notes(replay),
        'doubts': doubts(replay),
    }


def _compared(replay: Replay, one: Compared) -> dict[str, Any]:
    """Return the numbers of a phase, or of all."""
    joints, names = replay.plan.joints, replay.deflection_names
    return {
        'duration_s': one.duration,
        'samples': one.samples,
        'incomplete': one.incomplete,
        'repeated': one.repeated,
        'motions': one.motions,
        'torque': {model: _agreement(joints, each) for model, each in one.torque.items()},
        'commanded': None if one.commanded is None else _agreement(joints, one.commanded),
        'shares': {name: _by_name(joints, share) for name, share in one.shares.items()},
        'deflection': {topic: _agreement(names, each) for topic, each in one.deflection.items()},
    }


def notes(replay: Replay) -> list[str]:
    """Return what a reader of a replay's numbers must know, in words."""
    found = []
    for one in replay.phases:
        if one.plant:
            numbers = ', '.join(
                f'{path} {_number(plant)} (model: {_number(model)})'
                for path, (plant, model) in one.plant.items()
            )
            found.append(f'{one.name}: the plant was another than the model, with {numbers}')
    if replay.set_back:
        found.append(f'the clock of the stamps was set back {replay.set_back} times')
    places = [jump for jump in replay.jumps if jump.kind == 'place']
    if places:
        found.append(
            f'the robot was put elsewhere {len(places)} times, first '
            f'{places[0].joint} by {places[0].size:.3g} at {places[0].time:.3f} s'
        )
    return found


def _number(value: Any) -> str:
    """Return one or several numbers as text."""
    return UNKNOWN if value is None else ' '.join(f'{each:.4g}' for each in np.atleast_1d(value))


def doubts(replay: Replay) -> list[str]:
    """Return the doubts about a replay's numbers, in words."""
    joints = replay.plan.joints
    found = [f'{one.name}: {doubt}' for one in replay.phases for doubt in doubts_of(joints, one)]
    if not replay.phases:
        found = doubts_of(joints, replay)
    if replay.friction is not None:
        found += _negative_friction(joints, replay.friction)
    return found


def doubts_of(joints: Sequence[str], one: Compared) -> list[str]:
    """Return the doubts about a phase: messages, jumps, and efforts that are no torques."""
    found = []
    left_out = one.incomplete + one.repeated
    if left_out > FEW * (left_out + one.samples):
        found.append(
            f'{left_out} of {left_out + one.samples} joint states were left out: '
            f'{one.incomplete} without every joint, {one.repeated} with stamps that do not rise'
        )
    found += jump_doubts(one.jumps)
    return found + ([] if one.sizes is None else effort_doubts(joints, one.sizes))


def _negative_friction(joints: Sequence[str], fit: FrictionFit) -> list[str]:
    found = []
    for term, values in (('viscous', fit.friction.viscous), ('coulomb', fit.friction.coulomb)):
        column = TERMS.index(term)
        error = np.nan_to_num(fit.by_window[:, column])
        matters = fit.size[:, column] > FEW * fit.rms_before
        for k in np.flatnonzero((values < -FAR * error) & matters).tolist():
            found.append(
                f'{joints[k]}: {term} friction must be >= 0, the fit gives {values[k]:.3g}'
            )
    return found


def _agreement(names: Sequence[str], one: Agreement) -> dict[str, dict[str, float | None]]:
    """Return an agreement by column, without the columns that have no sample."""
    columns = {name: _by_name(names, values) for name, values in vars(one).items()}
    counts = columns.pop('samples')
    return {
        name: {measure: values[name] for measure, values in columns.items()}
        for name in names
        if counts[name]
    }


def _friction(joints: Sequence[str], fit: FrictionFit) -> dict[str, dict[str, Any]]:
    rows = {}
    for k, joint in enumerate(joints):
        values = zip(TERMS, vars(fit.friction).values(), strict=True)
        row: dict[str, Any] = {term: float(value[k]) for term, value in values}
        for kind, errors in (('formal', fit.formal), ('by_window', fit.by_window)):
            row[f'standard_error_{kind}'] = dict(zip(TERMS, map(plain, errors[k]), strict=True))
        for measure in ('rms_before', 'rms_after', 'explained'):
            row[measure] = plain(getattr(fit, measure)[k])
        rows[joint] = row
    return rows


def _adapted(found: Adapted) -> dict[str, Any]:
    """Return numbers over time: all the times, or as many as a line can show."""
    shown = np.unique(np.linspace(0, len(found.t) - 1, SAMPLES).astype(int))[: len(found.t)]
    half = NORMAL * found.deviations
    numbers = {}
    for k, path in enumerate(found.paths):
        last = plain(half[-1, k]) if len(half) else None
        numbers[path] = {
            'start': float(found.start[k]),
            'bounds': found.bounds[k].tolist(),
            'value': float(found.last[k]),
            'half_interval': last,
            'supported': bool(found.supported[k]),
            'values': found.values[shown, k].tolist(),
            'half_intervals': half[shown, k].tolist(),
        }
    return {
        'time_s': found.t[shown].tolist(),
        'numbers': numbers,
        'cause': found.cause,
        'model_error': found.model_error,
        'restarts': found.restarts,
        'model_failures': found.failures,
    }


def _by_name(names: Sequence[str], values: NDArray[Any]) -> dict[str, float | None]:
    return dict(zip(names, map(plain, values), strict=True))


def parts_of(summary: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Return the numbers by phase; those of all under '' where no phase is named."""
    return summary['phases'] or {'': summary}


def error_rows(summary: Mapping[str, Any]) -> Iterator[str]:
    """Yield the errors of each model and of each prediction as text for the terminal."""
    for phase, part in parts_of(summary).items():
        for what in ('torque', 'deflection'):
            for name, columns in part[what].items():
                for column, one in columns.items():
                    error = f'rms {one["rms"]:.3g} of {one["measured_rms"]:.3g}'
                    yield f'{phase}{": " * bool(phase)}{what} {name}, {column}: {error}'


def lines(summary: Mapping[str, Any], tables: Iterable[str]) -> Iterator[str]:
    """Yield a replay's numbers as lines of text for the terminal, with tables of its errors."""
    yield (
        f'{summary["bag"]}: {summary["samples"]} joint states in {summary["duration_s"]:.4g} s, '
        f'{summary["derivative"]} {summary["cutoff_hz"]:.3g} Hz'
    )
    for what in ('held_joints', 'ignored_joints'):
        if summary[what]:
            yield f'  {what.replace("_", " ")}: {", ".join(summary[what])}'
    yield from tables
    if summary['output']:
        yield f'bag     {summary["output"]}'
    for note in summary['notes']:
        yield f'note: {note}'
    for doubt in summary['doubts']:
        yield f'doubtful: {doubt}'
