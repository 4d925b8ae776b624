"""The whole model by maximum likelihood over all channels of all recordings at once.

Each channel's residuals count by their own standard deviation, which the fit finds as well; few
that are far off do not count as squares (Huber's loss). What the data do not tell stays where the
robot has it: a prior of width exp(+-0.5) is part of the search and of no interval.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from denoc_ros.dynamics.driven.measured_side import measured_robot
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import IdentificationError
from denoc_ros.identification.model.free_parameters import PRIOR, FreeParameters
from denoc_ros.identification.model.information import (
    NOT_TOLD,
    VERDICTS,
    combinations,
    interval_ends,
    verdict_of,
)
from denoc_ros.identification.model.prediction import PreparedRun
from denoc_ros.identification.model.search import ModelSearch, is_stiffness, vector_of
from denoc_ros.identification.model.sources import (
    Recording,
    RecordingSettings,
    read_source,
    reading_spreads,
)
from denoc_ros.model.tree import RigidInertia
from denoc_ros.types import Array

Source = Recording | str | Path

HELD_OUT = 0.25
UNEXPLAINED = 0.1  # of a channel: the model is not what made it
NEGLIGIBLE = 0.02  # of a channel: so little may be left of a held-out part
SHAKEN = 2.0  # times what noise of the joints makes of a channel: no fault of the model
FAR = 2.0  # deviations of the prior: a stiffness beyond has the search begin anew
RESTARTS = 3
AGREES = 0.8  # of a channel's residuals: with less a recording alone has other numbers
WORSE = 1.5  # times the rms of what was fitted: a held-out part that is not explained


@dataclass(frozen=True)
class ChannelFit:
    """Residuals of a channel, rms in its unit: over the fitted samples and the held-out ones.

    `size` is the channel's own deviation, `louder` how much more it moves while it is held out.
    `shaken` and `held_out_shaken` are what noise of the measured joints makes of the prediction;
    `unforeseen` and `held_out_unforeseen` what could not be foreseen of the residuals, in their
    deviations: where links vibrate, less hangs on how they happen to do so. `alone` is about which
    share of the residuals a fit to this run alone would leave.
    """

    run: str
    name: str
    unit: str
    samples: int
    size: float
    louder: float
    before: float
    after: float
    held_out_before: float
    held_out_after: float
    shaken: float = 0.0
    held_out_shaken: float = 0.0
    unforeseen: float = 1.0
    held_out_unforeseen: float = np.inf
    alone: float = 1.0

    @property
    def group(self) -> tuple[str, str]:
        """The run, and the vector that the channel is one axis of."""
        return self.run, vector_of(self.name)


@dataclass(frozen=True)
class IdentifiedModel:
    """A robot's numbers as data tell them.

    Attributes
    ----------
    values, start : dict of str to float
        By dotted path; `link.<link>.*` about the link frame's origin.
    interval : dict of str to (float, float)
        95 %; without end where not identifiable.
    size : dict of str to float
        What half an interval is a share of in the verdict: the number itself where it must be
        positive, else the size of what it adds to, such as the spread of a sensor's values.
    verdict : dict of str to str
        found (within 5 % of `size`), doubtful (within 50 %) or not identifiable.
    combinations : list of str
        What the data tell of parameters that are not identifiable one by one.
    channels : tuple of ChannelFit
    reasons : tuple of str
        Why values that were found are doubtful, and which stiffnesses began too far off.
    overrides : dict of str to number or list
        Of the robot, what was found or doubtful.
    bodies : dict of str to RigidInertia
        What each free body has more than at the start, about its link frame's origin.
    robot : Robot
        With all values.
    seconds : float
    evaluations : int
        Of the model along all recordings.
    without_effect : tuple of str
        Paths that no measurement of the robot depends on, whatever the motion: across the plane
        of a planar robot. They are not identifiable, and count in no verdict of the whole.
    """

    values: dict[str, float]
    start: dict[str, float]
    interval: dict[str, tuple[float, float]]
    size: dict[str, float]
    verdict: dict[str, str]
    combinations: list[str]
    channels: tuple[ChannelFit, ...]
    reasons: tuple[str, ...]
    overrides: dict[str, float | list[float]]
    bodies: dict[str, RigidInertia]
    robot: Robot
    seconds: float
    evaluations: int
    without_effect: tuple[str, ...] = ()

    @property
    def whole_verdict(self) -> str:
        """The worst verdict of the numbers that a measurement of the robot can depend on."""
        given = [v for path, v in self.verdict.items() if path not in self.without_effect]
        return max(given, key=VERDICTS.index, default=NOT_TOLD)


def identify_model(
    robot: Robot,
    recordings: Source | Sequence[Source],
    free: Sequence[str],
    *,
    cutoff: float = 20.0,
    held_out: float = HELD_OUT,
    step: float = 5e-4,
    poses: Mapping[str, str] | None = None,
) -> IdentifiedModel:
    """Fit a robot's numbers to recordings by maximum likelihood.

    Parameters
    ----------
    robot : Robot
        Where the search starts. Joints that are measured on the link side of their springs count
        as rigid there, and their effort as what the gear gives out.
    recordings : path, Recording, or a sequence of them
        Runs with joint positions and measured effort, gauges, IMUs or other sensors of the model.
    free : sequence of str
        Dotted paths with `*`: see :class:`FreeParameters`.
    cutoff : float
        Of the low-pass that measured and predicted effort go through [Hz].
    held_out : float
        Last part of each run that a first fit does not see, and is judged by; 0: none.
    step : float
        Longest step of the amplitudes' integration [s].
    poses : dict of str to str, optional
        Topic of geometry_msgs/PoseStamped of a tracker to the frame whose pose it has.

    Raises
    ------
    ConfigError
        A path that is of nothing.
    BagError, IdentificationError
        A recording that cannot be read, or has too little.
    """
    if not 0.0 <= held_out < 1.0:
        raise IdentificationError(f'held_out must be in [0, 1), got {held_out}')
    given = [recordings] if isinstance(recordings, Source) else list(recordings)
    robot = measured_robot(robot.with_modelled_payloads())
    if not given:
        raise IdentificationError('identify model: recordings must be given, got none')
    settings = RecordingSettings(poses=poses or {})
    whole = [r if isinstance(r, Recording) else read_source(r, robot, settings) for r in given]
    whole = _named_apart(whole)
    began = time.perf_counter()
    found = _fitted(_search(robot, whole, free, cutoff, step), held_out)
    start, evaluations = found.start, found.evaluations
    if found.reasons or _far_stiffness(found):
        scan = _search(robot, whole, free, cutoff, step)
        if sizes := scan.stiffnesses():
            scaled = robot.with_overrides(sizes)
            other = _fitted(_search(scaled, whole, free, cutoff, step), held_out)
            evaluations += scan.evaluations + other.evaluations
            if _misfit(other) < _misfit(found):
                robot, found = scaled, other
    for _ in range(RESTARTS):
        far = _far_stiffness(found)
        if not far:
            break
        # from a stiffness that is nearer: modes of a wrong frequency lead a search astray
        again = robot.with_overrides({path: found.values[path] for path in far})
        found = _fitted(_search(again, whole, free, cutoff, step), held_out)
        evaluations += found.evaluations
    seconds = time.perf_counter() - began
    led = {path: start[path] for path in _far_stiffness(replace(found, start=start))}
    told = with_far_starts(_doubted(_recorded_doubts(found, whole)), led)
    return replace(told, start=start, seconds=seconds, evaluations=evaluations)


def _named_apart(recordings: Sequence[Recording]) -> list[Recording]:
    """Return recordings whose names differ: `bag`, `bag (2)`."""
    found: list[Recording] = []
    for recording in recordings:
        taken, name, count = {each.name for each in found}, recording.name, 1
        while name in taken:
            count += 1
            name = f'{recording.name} ({count})'
        found.append(replace(recording, name=name))
    return found


def _misfit(found: IdentifiedModel) -> float:
    """Mean logarithm of the channels' residuals: the lower, the likelier."""
    samples = np.array([each.samples for each in found.channels])
    left = np.array([each.after for each in found.channels])
    return float(samples @ np.log(np.maximum(left, 1e-300)) / samples.sum())


def _far_stiffness(found: IdentifiedModel) -> list[str]:
    """Return the stiffnesses that the search has moved further than its prior trusts."""
    return [
        path
        for path, value in found.values.items()
        if is_stiffness(path) and abs(math.log(value / found.start[path])) > FAR * PRIOR
    ]


def _doubted(found: IdentifiedModel) -> IdentifiedModel:
    """Return the result, doubtful where a stiffness is still far from where its search began."""
    far = [
        f'{path}: value must be within a factor of {math.exp(FAR * PRIOR):.2g} of the one that '
        f'the search begins with ({found.start[path]:.4g}), got {found.values[path]:.4g}'
        for path in _far_stiffness(found)
    ]
    return _doubted_for(found, far)


def _recorded_doubts(found: IdentifiedModel, whole: Sequence[Recording]) -> IdentifiedModel:
    """Return the result, doubtful where a recording is."""
    doubts = [f'{each.name}: {doubt}' for each in whole for doubt in each.doubts]
    return _doubted_for(found, doubts)


def _doubted_for(found: IdentifiedModel, reasons: Sequence[str]) -> IdentifiedModel:
    """Return the result, in which nothing is better than doubtful where there are reasons."""
    if not reasons:
        return found
    words = {p: 'doubtful' if v == 'found' else v for p, v in found.verdict.items()}
    return replace(found, verdict=words, reasons=(*found.reasons, *reasons))


def with_far_starts(found: IdentifiedModel, led: Mapping[str, float]) -> IdentifiedModel:
    """Return the result with a reason for each stiffness that began far off and is not found.

    Parameters
    ----------
    led : mapping of str to float
        Where the first search began, of each stiffness that ended far from there.
    """
    reasons = tuple(
        f'{path}: search must begin within a factor of {math.exp(FAR * PRIOR):.2g} of the '
        f'stiffness, got {begun:.4g}, from where it came to {found.values[path]:.4g}: begin '
        f'nearer, with the stiffness of the first natural frequency'
        for path, begun in led.items()
        if found.verdict[path] != 'found'
    )
    return replace(found, reasons=(*found.reasons, *reasons))


def _search(
    robot: Robot, whole: Sequence[Recording], free: Sequence[str], cutoff: float, step: float
) -> ModelSearch:
    runs = [PreparedRun(recording, robot, cutoff, step) for recording in whole]
    return ModelSearch(runs, free_parameters(robot, free, whole))


def _fitted(search: ModelSearch, held_out: float) -> IdentifiedModel:
    try:
        return _searched(search, held_out)
    except np.linalg.LinAlgError as error:
        names = ', '.join(sorted({name for name, _, _ in search.labels}))
        raise IdentificationError(
            f'{names}: recordings must determine the numbers that are free, '
            f'got equations without a solution: {error}'
        ) from error


def _searched(search: ModelSearch, held_out: float) -> IdentifiedModel:
    began = time.perf_counter()
    parameters = search.parameters
    zero = np.zeros(parameters.size)
    held = ~search.rows_before(1.0 - held_out)
    parts = ~held, held
    before = search.rms(search.whole_residuals(zero), parts)
    start = search.approach(zero, 1.0 - held_out)
    # The fit begins with the motion that judges it, and ends with the one that noise is put on.
    judge = search.whole_residuals(start)
    theta = search.fit(start, np.ones(len(search.row_t), dtype=bool))
    if not held_out:
        judge = search.residuals(theta)
    after, unforeseen = search.rms(judge, parts), search.rms(search.whitening(judge), parts)
    shaken = [search.shaken(theta, rows) for rows in parts]
    alone = search.alone(theta) if search.has_several_runs else np.ones(len(search.labels))
    sides = zip(
        search.sizes,
        search.louder(held),
        before[0],
        after[0],
        before[1],
        after[1],
        *shaken,
        *unforeseen,
        alone,
        strict=True,
    )
    channels = tuple(
        ChannelFit(*label, int(samples), *map(float, row))
        for label, samples, row in zip(search.labels, search.counts, sides, strict=True)
    )
    return _concluded(search, theta, channels, time.perf_counter() - began)


def free_parameters(
    robot: Robot, free: Sequence[str], recordings: Sequence[Recording]
) -> FreeParameters:
    """Free parameters of a robot, scaled by the recorded efforts and spreads."""
    sizes = _largest_efforts(recordings), _spreads(robot, recordings)
    return FreeParameters(robot, free, *sizes, [each.name for each in recordings])


def _largest_efforts(recordings: Sequence[Recording]) -> dict[str, float]:
    found: dict[str, float] = {}
    for recording in recordings:
        for name, column in zip(recording.joints, recording.effort.T, strict=True):
            seen = column[np.isfinite(column)]
            if len(seen):
                found[name] = max(found.get(name, 0.0), float(np.abs(seen).max()))
    return {name: size for name, size in found.items() if size > 0.0}


def _spreads(robot: Robot, recordings: Sequence[Recording]) -> dict[str, float]:
    """Return by how much each sensor's value varies at most in a run, by name."""
    gains = {sensor.name: abs(sensor.gain) for sensor in robot.tree.sensors}
    found: dict[str, float] = {}
    for recording in recordings:
        for name, spread in reading_spreads(recording, robot.tree).items():
            found[name] = max(found.get(name, 0.0), gains.get(name, 1.0) * spread)
    return found


def _concluded(
    search: ModelSearch, theta: Array, channels: tuple[ChannelFit, ...], seconds: float
) -> IdentifiedModel:
    parameters = search.parameters
    info = search.information(theta)
    values, scales = parameters.values(theta), parameters.scales(theta)
    reasons = (*_reasons(channels), *search.effort_doubts(theta))
    half = info.half * scales
    sizes = parameters.sizes(theta)
    verdicts = [verdict_of(share) for share in half / sizes]
    verdicts = ['doubtful' if reasons and v == 'found' else v for v in verdicts]
    factors = parameters.multiplicative
    low, high = interval_ends(values, half, factors)
    known = np.array([verdict != NOT_TOLD for verdict in verdicts])
    told = {path for path, is_told in zip(parameters.paths, known, strict=True) if is_told}
    # a centre of mass is written whole: what is not told of it stays as it was
    kept = theta.copy()
    kept[: len(parameters.numbers)][~known[: len(parameters.numbers)]] = 0.0
    settings = parameters.settings(theta)
    return IdentifiedModel(
        _by_path(parameters, values),
        _by_path(parameters, parameters.values(np.zeros(parameters.size))),
        {p: (float(a), float(b)) for p, a, b in zip(parameters.paths, low, high, strict=True)},
        _by_path(parameters, sizes),
        dict(zip(parameters.paths, verdicts, strict=True)),
        combinations(info, parameters.paths, factors, parameters.has_effect),
        channels,
        reasons,
        {
            path: value
            for path, value in parameters.overrides(parameters.settings(kept)).items()
            if path in told or any(each.startswith((f'{path}.', f'{path}[')) for each in told)
        },
        parameters.changes(theta),
        parameters.robot_at(settings),
        seconds,
        search.evaluations,
        tuple(
            p
            for p, is_seen in zip(parameters.paths, parameters.has_effect, strict=True)
            if not is_seen
        ),
    )


def _reasons(channels: tuple[ChannelFit, ...]) -> tuple[str, ...]:
    """Reasons why the model does not explain the recordings.

    What is left is compared with the largest of a sensor's axes: one along which nothing happens
    shows its noise alone.
    """
    sizes: dict[tuple[str, str], float] = {}
    for one in channels:
        sizes[one.group] = max(sizes.get(one.group, 0.0), one.size)
    unexplained = [
        f'{one.run}: {one.name}: what the model leaves must be below a tenth of what is measured '
        f'({sizes[one.group]:.3g} {one.unit}), got {one.after:.3g}'
        for one in channels
        if one.after > max(UNEXPLAINED * sizes[one.group], SHAKEN * one.shaken)
    ]
    worse = [
        f'{one.run}: {one.name}: held-out rms must be near that of the fit '
        f'({one.after:.3g} {one.unit}), got {one.held_out_after:.3g}'
        for one in channels
        if one.held_out_after
        > max(
            WORSE * one.after * max(1.0, one.louder),
            NEGLIGIBLE * sizes[one.group],
            SHAKEN * one.held_out_shaken,
        )
        and one.held_out_unforeseen > WORSE * one.unforeseen * max(1.0, one.louder)
    ]
    apart = [
        f'{one.run}: {one.name}: recordings that are fitted together must agree, got a residual '
        f'of {one.after:.3g} {one.unit} where this one alone leaves about '
        f'{one.alone * one.after:.3g}'
        for one in channels
        if one.alone < AGREES and (1.0 - one.alone) * one.after > NEGLIGIBLE * sizes[one.group]
    ]
    return (*unexplained, *worse, *apart)


def _by_path(parameters: FreeParameters, values: Array) -> dict[str, float]:
    return {path: float(v) for path, v in zip(parameters.paths, values, strict=True)}
