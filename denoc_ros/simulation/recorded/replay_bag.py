"""A recorded run replayed through a model: a bag with computed topics, and their fit."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from denoc_ros.bags.joint_state import JOINT_STATE, JointStateMessage
from denoc_ros.bags.reader import DESCRIPTION_ATTACHMENT, read_raw
from denoc_ros.bags.run import RecordedPhase, motions_of
from denoc_ros.bags.series import ODOMETRY_NUMBERS, elapsed, read_numbers
from denoc_ros.bags.writer import BagWriter
from denoc_ros.dynamics.base.reacting_base import held_robot
from denoc_ros.dynamics.driven.measured_side import measured_robot
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import BagError, SolverError, StateError
from denoc_ros.estimation.base_track import BaseRecord
from denoc_ros.estimation.torque_along import TorqueReplay, Torques
from denoc_ros.output_files import require_new, whole_file
from denoc_ros.simulation.recorded.adapted import AdaptAlong, Adapted
from denoc_ros.simulation.recorded.agreement import BINS, JoinedTraces, Traces
from denoc_ros.simulation.recorded.compared import Compared, Comparer
from denoc_ros.simulation.recorded.plausibility import LONGEST_GAP_S
from denoc_ros.simulation.recorded.recorded_stream import Block, JointStream
from denoc_ros.simulation.recorded.replay_settings import (
    PREFIX,
    ReplayPlan,
    ReplaySettings,
    plan_replay,
)
from denoc_ros.simulation.recorded.residual_friction import FrictionFit, FrictionFitter
from denoc_ros.simulation.recorded.run_files import (
    find_bag,
    plant_differences,
    recorded_phases,
    robot_of_run,
)
from denoc_ros.types import Array

Progress = Callable[[float], object]
Message = tuple[int, str, bytes]  # log time, topic, CDR

FEWEST_BINS = 500  # of the curves of a phase


@dataclass(frozen=True, kw_only=True)
class Replay(Compared):
    """Result of a replay: numbers of all phases together, and of each.

    Attributes
    ----------
    plan : ReplayPlan
        What of the bag it went by.
    held : tuple of str
        Joints of the robot that stand at 0: neither driven, nor mimics, nor given by loops.
    settings : ReplaySettings
        How it was made.
    period, cutoff : float
        Usual time between joint states [s], and the cutoff as used [Hz].
    friction : FrictionFit or None
        Where it was asked for; of all phases together.
    deflection_names : tuple of str
        `link/ux` ... `link/rz`.
    torque_traces : dict of str to JoinedTraces
        measured and each model: by joint.
    deflection_traces : dict of str to JoinedTraces
        replay and each topic that has deflections.
    set_back : int
        How often the clock of the stamps was set back.
    phases : tuple of Compared
        Those that have joint states; none where the recording names no phases.
    adapted : Adapted or None
        Numbers of the robot over time, where they were asked for.
    """

    plan: ReplayPlan
    held: tuple[str, ...]
    settings: ReplaySettings
    period: float
    cutoff: float
    friction: FrictionFit | None
    deflection_names: tuple[str, ...]
    torque_traces: dict[str, JoinedTraces]
    deflection_traces: dict[str, JoinedTraces]
    set_back: int
    phases: tuple[Compared, ...]
    adapted: Adapted | None = None


def replay(
    run: str | Path,
    robot: Robot | str | Path | None = None,
    output: str | Path | None = None,
    settings: ReplaySettings | None = None,
    *,
    phases: Sequence[str] = (),
) -> Replay:
    """Recompute torque and deflection along a run, phase by phase.

    Parameters
    ----------
    run : str or Path
        A directory made by `denoc up`, or a bag.
    robot : Robot or path, optional
        The model; default: the one in the bag, with what the session has changed of it.
    output, settings
        As of `replay_bag`.
    phases : sequence of str
        Phases that count; default: all.

    Raises
    ------
    BagError, ModelError, ConfigError, StateError, SolverError
        As of `replay_bag`; also a run without robot, or without such a phase.
    """
    path = Path(run)
    bag = find_bag(path)
    chosen = replayed_phases(path, bag, phases, robot is None)
    if not isinstance(robot, Robot):
        robot = robot_of_run(path, robot)
    return replay_bag(bag, robot, output, settings, phases=chosen)


def replayed_phases(
    run: Path, bag: Path, names: Sequence[str], is_recorded_robot: bool
) -> tuple[RecordedPhase, ...]:
    """Return the phases of a run from their references on; with their models or without.

    A robot that is given is the model of all phases.
    """
    found = motions_of(bag, recorded_phases(run, names))
    return found if is_recorded_robot else tuple(replace(each, model=None) for each in found)


def replay_bag(
    bag: str | Path,
    robot: Robot,
    output: str | Path | None = None,
    settings: ReplaySettings | None = None,
    progress: Progress | None = None,
    adapt: AdaptAlong | None = None,
    phases: Sequence[RecordedPhase] | None = None,
) -> Replay:
    """Recompute torque and deflection along the motion that a bag has.

    The motion begins anew with each phase, and what lies between phases is left out.

    Parameters
    ----------
    bag : str or Path
        A rosbag2 folder, a bare `.mcap` or a bare `.db3` file.
    robot : Robot
        The model; joints are matched by name.
    output : str or Path, optional
        A new bag: all that was recorded, byte by byte, with the topics `/replay/rigid/effort`
        and, for flexible robots, `/replay/flexible/effort`, `/replay/tip_deflection` and
        `/replay/modal_state` beside it (the last with elastic joints as well). None: nothing is
        written.
    settings : ReplaySettings, optional
        How.
    progress : callable, optional
        Called with the share of the work that was done since the last call.
    adapt : AdaptAlong, optional
        Numbers of the robot that are tracked along the motion, as the predictor does it; torques
        and deflections are those of the robot as it is given.
    phases : sequence of RecordedPhase, optional
        The phases of the recording; default: those that the bag marks, each from its reference
        on.

    Raises
    ------
    BagError
        The bag cannot be read or has no joint states of the robot; the output exists or cannot be
        written.
    ModelError
        The robot has loops and flexible links, or loops on a base that moves.
    ConfigError
        Numbers that cannot be tracked.
    StateError, SolverError
        Joints that leave a mechanism free or are tied to each other; loops that do not close; a
        base that floats in a way the bag does not tell.
    """
    settings = settings or ReplaySettings()
    if phases is None:
        phases = motions_of(Path(bag), recorded_phases(Path(bag)))
    work = _Work(Path(bag), robot, settings, progress, phases)
    adapted = work.adapted(adapt) if adapt is not None and adapt.paths else None
    if output is None:
        for _ in work.messages():
            pass
    else:
        _write(work, Path(bag), Path(output))
    return replace(work.result(), adapted=adapted)


def _write(work: _Work, bag: Path, output: Path) -> None:
    require_new(output)
    # half a bag would pass for a whole one
    with whole_file(output, parents=True) as unfinished, BagWriter(unfinished) as writer:
        writer.attach(DESCRIPTION_ATTACHMENT, work.description)
        for topic in work.plan.contents.topics:
            if not topic.name.startswith(PREFIX):
                writer.add_topic(topic.name, topic.type, topic.qos, topic.definition)
        for name in work.topics:
            writer.add_topic(name, JOINT_STATE)
        made = ((*message, JOINT_STATE) for message in work.messages())
        for log_ns, topic_name, raw, kind in heapq.merge(
            _recorded(bag), made, key=lambda message: message[0]
        ):
            writer.write(topic_name, log_ns, raw, type_name=kind)


def _recorded(bag: Path) -> Iterator[tuple[int, str, bytes, str]]:
    """Yield the recorded messages, each with its type, without those of an older replay."""
    for topic, kind, log_ns, raw in read_raw(bag):
        if not topic.startswith(PREFIX):
            yield log_ns, topic, raw, kind


def _torques(model: TorqueReplay, t: Array, block: Block) -> Torques:
    try:
        return model.torques(t, block.motion, block.starts)
    except SolverError as error:
        q, qd = (np.abs(each).max() for each in (block.motion.q, block.motion.qd))
        raise SolverError(
            f'joint states from {t[0]:.3f} to {t[-1]:.3f} s must be a motion that the model can '
            f'make, got positions up to {q:.3g} (rad, m), rates up to {qd:.3g} per s: {error}'
        ) from error


def _encoded(
    block: Block, torques: Torques, encoders: dict[str, JointStateMessage]
) -> Iterator[Message]:
    """Yield a block's messages, row by row."""
    motion = (block.motion.q, block.motion.qd)
    values: dict[str, tuple[Array, ...]] = {
        f'{PREFIX}{model}/effort': (*motion, torque) for model, torque in torques.models.items()
    }
    if torques.deflection is not None:
        values[f'{PREFIX}tip_deflection'] = tuple(torques.deflection)
    if torques.modal is not None:
        values[f'{PREFIX}modal_state'] = tuple(torques.modal)
    for k, (stamp_ns, log_ns) in enumerate(
        zip(block.stamp_ns.tolist(), block.log_ns.tolist(), strict=True)
    ):
        for topic, encoder in encoders.items():
            yield log_ns, topic, encoder.encode(stamp_ns, *(part[k] for part in values[topic]))


def _joined(parts: Sequence[Mapping[str, Traces]]) -> dict[str, JoinedTraces]:
    return {name: JoinedTraces([part[name] for part in parts]) for name in parts[0]}


class _Work:
    """One replay under way."""

    def __init__(
        self,
        bag: Path,
        robot: Robot,
        settings: ReplaySettings,
        progress: Progress | None,
        phases: Sequence[RecordedPhase],
    ) -> None:
        floats = len(robot.base_indices) > 0
        modelled = [robot.with_overrides(each.model) if each.model else robot for each in phases]
        self._plants = [
            plant_differences(model, phase.plant or {})
            for model, phase in zip(modelled, phases, strict=True)
        ]
        robot = measured_robot(held_robot(robot))
        self.plan = plan_replay(bag, robot, settings, floats, phases)
        self._base: BaseRecord | None = None
        self._base_span = -np.inf, np.inf
        self._settings = settings
        self._progress = progress
        self._passes = 2 if settings.fit_friction else 1
        turns = [robot.tree.joints[joint].continuous for joint in self.plan.joints]
        self._stream = JointStream(self.plan.source, settings.derivative, settings.cutoff, turns)
        self._read_base(bag, floats)
        self._robot = robot
        self._fit = self._fitted() if settings.fit_friction else None
        friction = None if self._fit is None else self._fit.friction
        posture, base = self.plan.posture, self._base
        self._model = TorqueReplay(robot, self.plan.joints, posture, friction, base=base)
        # by phase: a session may have had another model in some
        self._models = [
            TorqueReplay(
                measured_robot(held_robot(model)), self.plan.joints, posture, friction, base=base
            )
            if phase.model
            else self._model
            for model, phase in zip(modelled, phases, strict=True)
        ]
        self._names = self._model.deflections.names
        self._compared: list[Comparer] = []  # by phase

    @property
    def description(self) -> str:
        """Description of the computed robot: a base with a known motion is held."""
        return self._robot.tree.source

    def _read_base(self, bag: Path, floats: bool) -> None:
        """Read how the base moved, on the clock of the rows."""
        if not self.plan.base:
            return
        settings, where = self._settings, f'{bag}: {self.plan.base}'
        stamp_ns, moved = read_numbers(bag, self.plan.base, ODOMETRY_NUMBERS, settings.stamp)
        rising = np.flatnonzero(np.diff(stamp_ns, prepend=-1) > 0)
        t = elapsed(stamp_ns[rising], int(next(iter(self._stream)).stamp_ns[0]))
        poses, twists = moved[rising, :7], moved[rising, 7:]
        longest = float(np.diff(t).max(initial=0.0))
        if longest > LONGEST_GAP_S:
            raise BagError(
                f'{where} must say how the base moves at least every {LONGEST_GAP_S:g} s, got a '
                f'gap of {longest:.3g} s'
            )
        self._base_span = float(t[0]) - LONGEST_GAP_S, float(t[-1]) + LONGEST_GAP_S
        try:
            self._base = BaseRecord(t, poses, twists, settings.derivative, settings.cutoff)
        except StateError as error:
            raise BagError(f'{where}: {error}') from error
        self._base.floats = floats

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics written beside the recorded ones."""
        efforts = [f'{PREFIX}{model}/effort' for model in self._model.models]
        tips = [f'{PREFIX}tip_deflection'] if self._names else []
        modal = [f'{PREFIX}modal_state'] if self._model.has_modes else []
        return (*efforts, *tips, *modal)

    def messages(self) -> Iterator[Message]:
        """Go through the bag; yield the computed rows of each joint state, by log time."""
        self._compared = []
        encoders = self._encoders()
        for block in self._stream:
            # the first block shows the period
            self._compared = self._compared or [self._comparer() for _ in self.plan.source.phases]
            self._require_base(block.t)
            torques = _torques(self._models[block.phase], block.t, block)
            self._compare(block, torques)
            yield from _encoded(block, torques, encoders)
            self._advance(block)

    def result(self) -> Replay:
        """Return the result."""
        stream, phases = self._stream, self.plan.source.phases
        parts = zip(stream.incomplete, stream.repeated, stream.jumps, strict=True)
        found = [
            replace(one.result(phase.name, *left_out), plant=plant)
            for phase, one, left_out, plant in zip(
                phases, self._compared, parts, self._plants, strict=True
            )
        ]
        whole = self._comparer()
        for one in self._compared:
            whole.include(one)
        together = whole.result(
            '',
            sum(stream.incomplete),
            sum(stream.repeated),
            [jump for jumps in stream.jumps for jump in jumps],
        )
        return Replay(
            **vars(together),
            plan=self.plan,
            held=self._model.held,
            settings=self._settings,
            period=stream.period,
            cutoff=stream.cutoff,
            friction=self._fit,
            deflection_names=self._names,
            torque_traces=_joined([one.torque_traces for one in self._compared]),
            deflection_traces=_joined([one.deflection_traces for one in self._compared]),
            set_back=stream.set_back,
            phases=tuple(one for one in found if one.name and one.samples),
        )

    def adapted(self, adapt: AdaptAlong) -> Adapted:
        """Go through the bag once for the numbers that are tracked."""
        return adapt.along(self._robot, self.plan, self._settings, self._base)

    def _fitted(self) -> FrictionFit:
        """Go through the bag once for the friction alone."""
        posture, base = self.plan.posture, self._base
        model = TorqueReplay(self._robot, self.plan.joints, posture, base=base)
        fitter = FrictionFitter(len(self.plan.joints))
        samples = 0
        for block in self._stream:
            self._require_base(block.t)
            torques = _torques(model, block.t, block)
            effort = self._effort(block)
            samples += int(np.count_nonzero(np.isfinite(effort)))
            rest = effort - model.without_friction(torques)
            fitter.add(block.t, block.motion.qd, rest, block.starts)
            self._advance(block)
        if not samples:
            raise BagError(
                f'{self.plan.source.path}: {self.plan.effort or self.plan.source.topic} must have '
                'measured effort to fit friction to, got none'
            )
        return fitter.fit()

    def _require_base(self, t: Array) -> None:
        """Raise BagError unless the base's motion is known at the times [s] of a block."""
        first, last = self._base_span
        if t[0] < first or t[-1] > last:
            raise BagError(
                f'{self.plan.source.path}: {self.plan.base} must say how the base moves while '
                f'joints do, {t[0]:.3f} to {t[-1]:.3f} s, got {first:.3f} to {last:.3f} s'
            )

    def _advance(self, block: Block) -> None:
        if self._progress is not None:
            self._progress(len(block.stamp_ns) / (self.plan.messages * self._passes))

    def _effort(self, block: Block) -> Array:
        if self.plan.effort:
            return block.beside[self.plan.effort].select(self.plan.joints).values
        return block.effort

    def _compare(self, block: Block, torques: Torques) -> None:
        commanded = None
        if self.plan.commanded:
            commanded = block.beside[self.plan.commanded].select(self.plan.joints).values
        deflections = {
            topic: block.beside[topic].select(self._names).values
            for topic in self.plan.deflections
        }
        effort = self._effort(block)
        self._compared[block.phase].add(
            block.t, block.starts, torques, effort, commanded, deflections
        )

    def _comparer(self) -> Comparer:
        plan = self.plan
        return Comparer(
            plan.joints,
            self._model.models,
            self._names,
            plan.deflections if self._names else (),
            bool(plan.commanded),
            self._stream.period,
            None if self._fit is None else np.asarray(self._fit.friction.offset),
            max(FEWEST_BINS, BINS // len(plan.source.phases)),
        )

    def _encoders(self) -> dict[str, JointStateMessage]:
        motion, full = ('position', 'velocity'), ('position', 'velocity', 'effort')
        names = {
            f'{PREFIX}tip_deflection': (self._names, motion),
            f'{PREFIX}modal_state': (self._model.whole.names, motion),
        }
        return {
            topic: JointStateMessage(*names.get(topic, (self.plan.joints, full)))
            for topic in self.topics
        }
