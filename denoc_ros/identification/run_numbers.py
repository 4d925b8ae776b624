"""The numbers of a robot by a recorded run: stiffness, payload and damping, phase by phase."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.bags.digest import file_hash
from denoc_ros.bags.run import LATEST_NS, RecordedPhase, motions_of, phases_of, read_marks
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import DenocError, IdentificationError, SolverError
from denoc_ros.identification.decay.analysis import analyse_decay
from denoc_ros.identification.decay.damping import USABLE
from denoc_ros.identification.decay.modes import GOOD, Modes, worst
from denoc_ros.identification.decay.record_segments import still_spans
from denoc_ros.identification.decay.records import Record
from denoc_ros.identification.model.free_parameters import moving_mass
from denoc_ros.identification.model.information import NOT_TOLD
from denoc_ros.identification.model.model_fit import IdentifiedModel, identify_model
from denoc_ros.identification.model.model_result import WORDS, result_of
from denoc_ros.identification.model.sources import (
    FEWEST,
    Recording,
    RecordingSettings,
    read_source,
)
from denoc_ros.identification.tables.tables import is_table
from denoc_ros.kernels.algebra import kalman
from denoc_ros.kernels.derivatives import forward_derivatives
from denoc_ros.kernels.dynamics import articulated, step
from denoc_ros.model.numbers import values_of
from denoc_ros.model.payloads import carrying_links
from denoc_ros.output_files import Document, plain
from denoc_ros.simulation.recorded.plausibility import gaps_between, jumps_between
from denoc_ros.simulation.recorded.run_files import (
    find_bag,
    read_session,
    recorded_phases,
    robot_of_run,
)
from denoc_ros.types import Array

# of a fit, for those that compile before a session
IDENTIFICATION_KERNELS = (
    *(kalman.linear_states, kalman.filter_gains, kalman.filter_values, step.advance_along),
    articulated.articulated_dynamics_rows,
    forward_derivatives.hybrid_dynamics_derivatives_rows,
)
SHORTEST_STRETCH = 2.0  # s of motion without a gap that tell of a robot
SAME_MODE = 0.03  # largest relative distance of two frequencies of one mode
FOUND = 'found'  # verdict of a number within 5 %
USED = (FOUND, 'doubtful')  # verdicts of numbers that go into the robot
SMALL_PAYLOAD = 0.05  # share of the robot's mass of a payload that may not be there
AS_WELL = 1.1  # times the rms that a model with more numbers leaves
NORMAL_95 = 1.96  # standard deviations in half a 95 % interval


@dataclass(frozen=True)
class FreeDecay:
    """A mode in a free decay that one sensor has measured."""

    phase: str
    begin: float  # since the first joint state of the recording [s]
    sensor: str
    link: str
    frequency: float  # [Hz]
    damping_ratio: float
    interval: tuple[float, float]  # 95 %, of the damping ratio
    verdict: str
    reason: str  # why the verdict is not good


@dataclass(frozen=True)
class BeamMode:
    """A mode of a beam, combined from the decays that show it."""

    link: str
    frequency: float  # [Hz]
    damping_ratio: float
    interval: tuple[float, float]  # 95 %, of the damping ratio
    decays: int


@dataclass(frozen=True)
class PlantNumbers:
    """What the phases with the same robot tell of it.

    A session can give a phase another plant: the phases with one plant are fitted together.
    """

    phases: tuple[str, ...]
    plant: Mapping[str, Any]  # overrides of the plant in these phases, as the session noted them
    model: IdentifiedModel
    decays: tuple[FreeDecay, ...]
    beams: tuple[BeamMode, ...]
    left_out: tuple[str, ...]  # what of the recording was not used, and why
    # path and largest mass [kg] of a payload that was looked for and is not there
    no_payload: tuple[str, float] | None = None


@dataclass(frozen=True)
class RunNumbers:
    """The numbers of a robot by a recorded run."""

    run: Path
    robot: Robot  # where the search began
    plants: tuple[PlantNumbers, ...]

    @property
    def single(self) -> PlantNumbers:
        """What is told of the robot.

        Raises
        ------
        IdentificationError
            The phases had different robots.
        """
        if len(self.plants) == 1:
            return self.plants[0]
        said = '; '.join(', '.join(map(repr, each.phases)) for each in self.plants)
        raise IdentificationError(
            f'{self.run}: phases must be those of one robot, got {len(self.plants)} by the '
            f'session: {said}: choose with --phase'
        )

    @property
    def overrides(self) -> dict[str, float | list[float]]:
        """What was found of the one robot, by dotted path, as `Robot.with_overrides` takes it."""
        return self.single.model.overrides


def identify(
    run: str | Path,
    robot: Robot | str | Path | None = None,
    *,
    phases: Sequence[str] = (),
    free: Sequence[str] = (),
    settings: RecordingSettings | None = None,
) -> RunNumbers:
    """Find the numbers of a robot by a recorded run.

    Parameters
    ----------
    run : path
        A directory made by `denoc up`, a bag, or a table of joints and sensors.
    robot : Robot or path, optional
        Where the search begins; default: the robot in the bag, with the gravity of the session.
    phases : sequence of str
        Phases of the run that count; default: all.
    free : sequence of str
        What is looked for, as `identify_model` takes it. Default: stiffness and damping of all
        beams and, where effort was recorded, a payload at the tip.
    settings : RecordingSettings, optional
        How the recording is read.

    Raises
    ------
    BagError, IdentificationError, ModelError, ConfigError
        The run cannot be read, has no such phase, or tells nothing of the robot.
    """
    path = Path(run)
    bag, session = find_bag(path), read_session(path)
    if not isinstance(robot, Robot):
        robot = robot_of_run(path, robot, before_simulation=True)
    whole = read_source(bag, robot, settings)
    groups: dict[str, list[RecordedPhase]] = {}
    has_none = is_table(bag) and not phases
    known = (RecordedPhase(''),) if has_none else motions_of(bag, recorded_phases(path, phases))
    for phase in known:
        plant = json.dumps(dict(phase.plant or {}), sort_keys=True)
        groups.setdefault(plant, []).append(phase)
    tip = session.get('tip', '')
    plants = tuple(
        _of_one_plant(robot, whole, group, free, tip, json.loads(plant))
        for plant, group in groups.items()
    )
    return RunNumbers(path, robot, plants)


def phase_numbers(files: Sequence[Path], robot: Robot, name: str, tip: str = '') -> PlantNumbers:
    """Find the numbers of a robot by one phase of a session that is still being recorded.

    Parameters
    ----------
    files : sequence of Path
        The finished files of the bag.
    robot : Robot
        Where the search begins.
    tip : str
        As of `default_free`.

    Raises
    ------
    BagError, IdentificationError
        The phase is not whole in one of the files, or tells nothing.
    """
    for file in files:
        for phase in motions_of(file, phases_of((), read_marks(file))):
            if phase.name == name and phase.end_ns < LATEST_NS:
                return _of_one_plant(robot, read_source(file, robot), [phase], (), tip, {})
    raise IdentificationError(f'phase {name!r} must be whole in one file of the bag, got none')


def default_free(robot: Robot, recording: Recording, tip: str = '') -> list[str]:
    """Return what a recording may tell of a robot: its beams and, by effort, its payload.

    Parameters
    ----------
    tip : str
        The link that carries the payload; '': one that has a payload, else the last link.
    """
    ends = ('.ei', '.gj', '.stiffness', '.damping_ratio')
    found = [
        path
        for path in values_of(robot.tree)
        if path.startswith(('beam.', 'flexible.')) and path.endswith(ends)
    ]
    if np.isfinite(recording.effort).any():
        carrying = carrying_links(robot.tree)
        loaded = [link for link, load in robot.tree.payloads.items() if load.mass > 0.0]
        known = [link for link in (tip, *loaded) if link in carrying]
        found += [f'payload.{link}' for link in (known or carrying[-1:])[:1]]
    return found


def _of_one_plant(
    robot: Robot,
    whole: Recording,
    phases: Sequence[RecordedPhase],
    free: Sequence[str],
    tip: str,
    plant: Mapping[str, Any],
) -> PlantNumbers:
    """Fit the phases with one plant together."""
    left_out: list[str] = []
    stretches = [each for phase in phases for each in _stretches(whole, phase, left_out)]
    if not stretches:
        raise IdentificationError('\n'.join(left_out))
    wanted = list(free) or default_free(robot, whole, tip)
    names = tuple(phase.name for phase in phases)
    try:
        model = identify_model(robot, stretches, wanted)
        absent = None if free else _small_payload(model, SMALL_PAYLOAD * moving_mass(robot))
        if absent is not None:
            # A payload that is not there would take up errors of the other numbers.
            others = [path for path in wanted if not path.startswith('payload.')]
            without = identify_model(robot, stretches, others)
            model, absent = (without, absent) if _explains(without, model) else (model, None)
    except SolverError as error:
        raise IdentificationError(
            f'{", ".join(filter(None, names)) or whole.name}: recording must be of this robot, '
            f'got one that no robot near it explains: {error}'
        ) from error
    decays = tuple(decay for each in stretches for decay in _decays(robot, each))
    left_out += _unused(robot, whole)
    return PlantNumbers(
        names,
        plant,
        _without_untold_payloads(model),
        decays,
        combined_modes(decays),
        tuple(left_out),
        absent,
    )


def _explains(model: IdentifiedModel, richer: IdentifiedModel) -> bool:
    """Say whether a model leaves as little of each channel as one with more numbers."""
    pairs = zip(model.channels, richer.channels, strict=True)
    return all(one.after <= AS_WELL * other.after for one, other in pairs)


def _small_payload(model: IdentifiedModel, small: float) -> tuple[str, float] | None:
    """Return path and largest mass of a payload that weighs less than what is small [kg].

    The search goes over the logarithm of a mass, where 0 is infinitely far: an interval that is
    wide there is narrow in kilograms.
    """
    for path, mass in model.values.items():
        if path.startswith('payload.') and path.endswith('.mass') and mass > 0.0:
            high = model.interval[path][1]
            most = mass * (1.0 + math.log(high / mass)) if math.isfinite(high) else math.inf
            if most <= small:
                return path, most
    return None


def _without_untold_payloads(model: IdentifiedModel) -> IdentifiedModel:
    """Return a model in which a payload whose mass is not told has no centre either."""
    untold = tuple(
        path.removesuffix('mass')
        for path, verdict in model.verdict.items()
        if path.startswith('payload.') and path.endswith('.mass') and verdict == NOT_TOLD
    )
    if not untold:
        return model
    verdict = {
        path: NOT_TOLD if path.startswith(untold) else word for path, word in model.verdict.items()
    }
    kept = {path: v for path, v in model.overrides.items() if not path.startswith(untold)}
    return replace(model, verdict=verdict, overrides=kept)


def _unused(robot: Robot, whole: Recording) -> Iterator[str]:
    """Yield what a recording does not have, as far as a user expects it to."""
    for joint in robot.tree.non_mimic_joints:
        if joint not in whole.joints:
            yield f'{whole.name}: {joint} must be recorded, got none of it: it is taken to be at 0'
    for joint, column in zip(whole.joints, whole.effort.T, strict=True):
        missing = int(np.count_nonzero(~np.isfinite(column)))
        if 0 < missing < len(column):
            yield (
                f'{whole.name}: effort of {joint} must be in every joint state, got none in '
                f'{missing} of {len(column)}: it is not used'
            )


def _stretches(whole: Recording, phase: RecordedPhase, left_out: list[str]) -> Iterator[Recording]:
    """Yield the stretches of a phase between resets and gaps: a fit must not cross them."""
    name = phase.name or whole.name
    begin, end = (1e-9 * (ns - whole.origin_ns) for ns in (phase.begin_ns, phase.end_ns))
    try:
        part = whole.between(begin, end)
    except IdentificationError as error:
        left_out.append(f'{name}: {error}')
        return
    jumps = jumps_between(part.t, part.position, part.velocity).any(axis=1)
    breaks = jumps | gaps_between(part.t, float(np.median(np.diff(part.t))))
    edges = [0, *(np.flatnonzero(breaks) + 1).tolist(), len(part.t)]
    for k, (first, last) in enumerate(itertools.pairwise(edges)):
        begin, end = float(part.t[first]), float(part.t[last - 1])
        own = f'{name} ({k + 1})' if len(edges) > 2 else name
        if end - begin < SHORTEST_STRETCH or last - first < FEWEST:
            left_out.append(
                f'{own}: a stretch without gap or jump must last {SHORTEST_STRETCH:g} s, got '
                f'{end - begin:.3g} s'
            )
        else:
            # a stretch is between the jumps that the whole recording is doubted for
            yield replace(part.between(begin, end), name=own, doubts=())


def _decays(robot: Robot, stretch: Recording) -> Iterator[FreeDecay]:
    """Yield the usable modes that each sensor of a beam shows while the joints stand."""
    spans = still_spans(stretch.t, stretch.position)
    for sensor in robot.tree.sensors:
        if sensor.name not in stretch.sensors or not sensor.link:
            continue
        t, raw = stretch.sensors[sensor.name]
        for span in spans:
            inside = (t >= span[0]) & (t <= span[1])
            try:
                record = Record(t[inside], sensor.gain * raw[inside], sensor.name)
                modes = analyse_decay(record, standing=[span]).modes
            except DenocError:
                continue  # a stop after which nothing swings
            yield from _usable(stretch.name, sensor.name, sensor.link, modes)


def _usable(phase: str, sensor: str, link: str, modes: Modes) -> Iterator[FreeDecay]:
    for k, verdict in enumerate(modes.verdict):
        if verdict in USABLE:
            low, high = modes.interval[k].tolist()
            yield FreeDecay(
                phase,
                float(modes.start),
                sensor,
                link,
                float(modes.frequency[k]),
                float(modes.damping_ratio[k]),
                (low, high),
                verdict,
                '; '.join(modes.reasons[k]),
            )


def combined_modes(decays: Sequence[FreeDecay]) -> tuple[BeamMode, ...]:
    """Return the modes of each beam by the means of good decays, weighted by their intervals."""
    groups: list[list[FreeDecay]] = []
    good = [each for each in decays if each.verdict == GOOD]
    for decay in sorted(good, key=lambda each: (each.link, each.frequency)):
        last = groups[-1] if groups else None
        is_same = last is not None and (
            last[0].link == decay.link and decay.frequency < (1.0 + SAME_MODE) * last[0].frequency
        )
        if is_same and last is not None:
            last.append(decay)
        else:
            groups.append([decay])
    return tuple(map(_mean_mode, groups))


def _mean_mode(group: Sequence[FreeDecay]) -> BeamMode:
    """Return the mean of one mode; decays that differ by more than their intervals widen it."""
    ratios = np.array([each.damping_ratio for each in group])
    halves = np.array([0.5 * (each.interval[1] - each.interval[0]) for each in group])
    weights: Array = 1.0 / np.maximum(halves, 1e-12) ** 2
    mean = float(weights @ ratios / weights.sum())
    half = float(1.0 / np.sqrt(weights.sum()))
    if len(group) > 1:
        spread = np.sqrt(weights @ (ratios - mean) ** 2 / weights.sum() / (len(group) - 1))
        half = max(half, NORMAL_95 * float(spread))
    frequency = float(weights @ [each.frequency for each in group] / weights.sum())
    return BeamMode(group[0].link, frequency, mean, (mean - half, mean + half), len(group))


def run_document(found: RunNumbers, file: str = '') -> Document:
    """Return a run's numbers as plain values.

    Parameters
    ----------
    file : str
        The robot's file; '': the robot in the bag.
    """
    bag = find_bag(found.run)
    plants = [_plant_document(each) for each in found.plants]
    document = {
        'kind': 'run',
        'source': {'file': str(found.run), 'sha256': file_hash(bag)},
        'method': 'output error, maximum likelihood over all channels of all phases of a plant',
        'model': {'file': file, 'robot': found.robot.tree.name},
        'plants': plants,
        'verdict': worst(tuple(each['verdict'] for each in plants)),
        'reasons': [reason for each in plants for reason in each['reasons']],
    }
    return dict(plain(document))


def _plant_document(found: PlantNumbers) -> Document:
    document = result_of(found.model)
    numbers = noted_numbers(found)
    needed = [one for one in numbers if one['needed']] or numbers
    return {
        'phases': list(found.phases),
        'plant': dict(found.plant),
        'numbers': numbers,
        'channels': document['channels'],
        'not_identifiable': document['not_identifiable'],
        'decays': [dataclasses.asdict(each) for each in found.decays],
        'beams': [dataclasses.asdict(each) for each in found.beams],
        'left_out': list(found.left_out),
        'verdict': worst(tuple(WORDS[one['verdict']] for one in needed)),
        'reasons': [*found.model.reasons, *found.left_out],
    }


def noted_numbers(found: PlantNumbers) -> list[dict[str, Any]]:
    """Return the numbers of a robot as plain values.

    Each has path, start, value, interval, verdict, and whether a motion of this robot `needed` it:
    damping is not needed, nor what no motion shows.
    """
    numbers: list[dict[str, Any]] = plain(result_of(found.model)['parameters'])
    for one in numbers:
        path = one['path']
        one['needed'] = not (path.endswith('.damping_ratio') or path in found.model.without_effect)
    if found.no_payload is not None:
        path, most = found.no_payload
        none = {'path': path, 'start': 0.0, 'value': 0.0, 'interval': [0.0, most], 'size': 0.0}
        numbers.append({**none, 'verdict': FOUND, 'needed': True})
    return numbers


def number_lines(found: PlantNumbers) -> Iterator[str]:
    """Yield the numbers that are used, found or doubtful, as text for the terminal."""
    for one in noted_numbers(found):
        low, high = one['interval']
        if one['verdict'] in USED and None not in (low, high):
            half, doubt = 0.5 * (high - low), '' if one['verdict'] == FOUND else ' (doubtful)'
            yield f'{one["path"]}: {one["start"]:.5g} -> {one["value"]:.5g} ± {half:.2g}{doubt}'
