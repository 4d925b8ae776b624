"""`denoc up CONFIG.yaml`: start the nodes, run the reference, record, end cleanly, report."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from denoc_ros.bags.series import read_joint_states
from denoc_ros.cli.arguments import add_json, add_number, add_option
from denoc_ros.cli.interrupts import Interrupts
from denoc_ros.cli.progress import Progress
from denoc_ros.cli.session.node_parameters import check_parameters, session_plant
from denoc_ros.cli.session.phase_plans import Task, with_plans
from denoc_ros.cli.session.processes import Processes, free_domain
from denoc_ros.cli.session.session import IDENTIFICATION, Session, session_nodes
from denoc_ros.cli.session.session_config import (
    AUTO,
    REAL,
    SIMULATED,
    TIMES,
    SessionConfig,
    load_config,
)
from denoc_ros.cli.session.session_file import SessionFile, conclude, print_summary
from denoc_ros.cli.warmup_verb import compile_all, estimate, kernels
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import ConfigError, DenocError
from denoc_ros.model.plant_description import description_in_words
from denoc_ros.model.reading.source import complete_text
from denoc_ros.pages.provenance import versions
from denoc_ros.parts import optional, required
from denoc_ros.simulation.reference_motion import trajectory_from_config
from denoc_ros.terminal_text import say

if TYPE_CHECKING:  # an optional extra
    from denoc_ros.nodes.session_client import SessionClient

NO_ROS = (
    'rclpy must be importable, got: {}; source a ROS 2 installation or '
    'pip install "denoc_ros[ros]"'
)

WHY = {REAL: 'real time', SIMULATED: 'simulated time, as asked for', AUTO: 'real time'}
NO_SOURCE = 'time must be real where no plant can make it, got simulated'
TAKEN = 'the directory must not exist yet, got {}'
DESCRIPTION = (
    'Start plant, recorder, predictor and feedforward as separate processes, run the reference, '
    'end them in order, and write a bag and a report into a new directory.'
)


@dataclasses.dataclass(frozen=True)
class SessionRun:
    """A session that has run."""

    folder: Path  # its directory
    summary: dict[str, Any]  # as in its summary.json; without a recording just what it was
    error: BaseException | None = None  # why it ended before its end


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_option(parser, 'config CONFIG.yaml', 'configuration file of the session')
    text = 'duration of each phase'
    add_number(parser, '--duration S', float, text, 's', positive=True, finite=True)
    add_option(
        parser,
        '--record',
        'record a bag and write the report (default: as in the configuration)',
        action=argparse.BooleanOptionalAction,
    )
    add_option(
        parser,
        '--time',
        'real time, simulated time in lockstep, or as the machine holds (default: as in '
        'the configuration, else auto)',
        choices=TIMES,
    )
    add_option(
        parser, '--input BAG', 'run on recorded joint states instead of the plant', type=Path
    )
    add_option(parser, '--output DIR', 'new directory of the run; default: runs/<time>', type=Path)
    add_option(
        parser,
        '--set PATH=VALUE',
        'change a value of the configuration or the model (beam.LINK.y.ei=9e4); repeatable',
        [],
    )
    add_option(parser, '--view', 'show the robot in the browser; prints the address')
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Run the verb and return the exit status; errors are raised."""
    with Interrupts(args.is_process) as interrupts:
        config = _configured(args)
        run_of = bring_up(config, args.input, args.output, args.command, interrupts)
    if args.json:
        say(json.dumps(run_of.summary, indent=2, allow_nan=False))
    else:
        print_summary(run_of.summary, run_of.folder)
    if run_of.error is not None:
        sys.stdout.flush()
        raise run_of.error
    return 0


def _configured(args: argparse.Namespace) -> SessionConfig:
    """Return the session's configuration, changed as the arguments say."""
    config = load_config(args.config, args.set)
    if args.duration is not None:
        config = dataclasses.replace(config, duration=args.duration)
    if args.time is not None:
        config = dataclasses.replace(config, time=args.time)
    if args.record is not None:
        config = dataclasses.replace(config, record=args.record)
    if args.view:
        nodes = {**config.nodes, 'viewer': {'port': 0, **config.nodes.get('viewer', {})}}
        config = dataclasses.replace(config, nodes=nodes, without=config.without - {'viewer'})
    return config


def bring_up(
    config: SessionConfig,
    bag: Path | None = None,
    output: Path | None = None,
    command: str = '',
    interrupts: Interrupts | None = None,
) -> SessionRun:
    """Run a session from start to report.

    Once its nodes are started it always comes to a report: that of a session which cannot go on
    has the cause as its headline.

    Parameters
    ----------
    bag : Path, optional
        Recorded joint states to run on instead of the plant.
    output : Path, optional
        The run's directory, which must not exist; default runs/<time>.
    interrupts : Interrupts, optional
        What holds signals back while the graph is entered and left.
    """
    if config.time != REAL and (bag is not None or 'plant' in config.without):
        if config.time == SIMULATED:
            raise ConfigError(str(config.path), [NO_SOURCE])
        config = dataclasses.replace(config, time=REAL)
    _require_ros()
    if output is not None and output.exists():
        raise ConfigError('--output', [TAKEN.format(output)])
    check_parameters(config, session_nodes(config, bag))
    for phase in config.phases:
        if phase.identify:
            whose = f'{config.path}: phase {phase.name!r}: identify'
            finder = required(IDENTIFICATION, whose)
            if 0.0 < config.duration < finder.SHORTEST_STRETCH:
                rule = f'each phase must last {finder.SHORTEST_STRETCH:g} s or more'
                raise ConfigError(whose, [f'{rule}, got duration: {config.duration:g}'])
            if not config.record:
                raise ConfigError(whose, ['the session must record, got record: false'])
    progress = Progress()
    _compile(config, progress, (interrupts or Interrupts()).check)
    with progress.step('loading the robot'):
        robot = load_robot(config.robot, gravity=config.gravity)
        if config.tip and config.tip not in robot.frame_names:
            known = ', '.join(robot.frame_names)
            raise ConfigError(
                str(config.path), [f'tip must be one of {known}, got {config.tip!r}']
            )
        plant = {**session_plant(config).overrides(robot.tree), **config.plant_model}
        for overrides in (*map(config.model_in, config.phases), plant):
            robot.with_overrides(overrides)
        task = _task(config, robot, bag)
        config = _started_on_the_reference(config, task)
    if outline := optional('viewer.outline'):  # what the page of the run draws
        outline.tell_missing_meshes(robot, config.robot.parent)
    config, task = _shaped(config, robot, task, progress)
    folder = new_folder(output)
    environment = {
        'ROS_AUTOMATIC_DISCOVERY_RANGE': os.environ.get(
            'ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST'
        ),
        'ROS_DOMAIN_ID': os.environ.get('ROS_DOMAIN_ID') or str(free_domain()),
        # nobody stops or kills what is in a session of its own, and ticks are late less often
        'FASTDDS_BUILTIN_TRANSPORTS': os.environ.get('FASTDDS_BUILTIN_TRANSPORTS', 'DEFAULT'),
    }
    os.environ.update(environment)
    (folder / 'configuration.yaml').write_bytes(config.path.read_bytes())
    values = _session_values(config, environment, command)
    if 'plant' in session_nodes(config, bag):
        values |= _beams(config, robot)
        progress.say(values['beams'])
    file = SessionFile(folder, values)
    processes = Processes(folder / 'logs', environment)
    interrupts = interrupts or Interrupts()
    error: BaseException | None = None
    shares: dict[str, float] = {}
    try:
        with _client(config, task, processes, interrupts) as client:
            session = Session(config, task, file, processes, client, progress)
            try:
                session.run()
            finally:
                with interrupts.held():
                    shares = session.end()
    except (Exception, KeyboardInterrupt) as caught:
        error = caught
    return SessionRun(
        folder, conclude(folder, file, error, shares, config.record, progress), error
    )


def _compile(config: SessionConfig, progress: Progress, watch: Callable[[], None]) -> None:
    """Compile the kernels that the session needs, if some are not in the cache."""
    loops = bool(config.joints)
    plans = any(phase.shape for phase in config.phases) or 'shaper' not in config.without
    feeds_back = any(map(config.has_state_feedback, config.phases))
    identifies = any(phase.identify for phase in config.phases)
    wanted = kernels(loops, plans, feeds_back, identifies)
    if expected := estimate(wanted):
        what = 'compiling the kernels in two processes, once per version and user'
        with progress.step(what, expected):
            compile_all(wanted, watch)


@contextmanager
def _client(
    config: SessionConfig, task: Task, processes: Processes, interrupts: Interrupts
) -> Iterator[SessionClient]:
    """Enter the graph, and leave it whatever happens: neither may be interrupted."""
    from denoc_ros.nodes.session_client import SessionClient

    description = complete_text(config.robot)

    def watch() -> None:
        interrupts.check()
        processes.check()

    topic = 'reference' if 'shaper' in config.without else 'shaper/input'
    client: SessionClient | None = None
    try:
        with interrupts.held():
            client = SessionClient(description, task.trajectory is not None, watch, topic)
        names = [*session_nodes(config, task.bag), *(['player'] if task.bag else [])]
        client.require_alone(names, config.time != REAL)
        yield client
    finally:
        if client is not None:
            with interrupts.held():
                client.close()


def _task(config: SessionConfig, robot: Robot, bag: Path | None) -> Task:
    joints = list(config.joints or robot.tree.non_mimic_joints)
    if bag is not None:
        duration = float(read_joint_states(bag).t[-1])
        return Task(None, joints, duration, bag)
    trajectory = None
    if config.reference:
        trajectory = trajectory_from_config(config.reference, joints, f'{config.path}: reference')
    duration = config.duration or (trajectory.duration if trajectory is not None else 0.0)
    if not duration:
        raise ConfigError(
            str(config.path),
            ['duration must be > 0 s where there is neither reference nor --input, got none'],
        )
    return Task(trajectory, joints, duration)


def _shaped(
    config: SessionConfig, robot: Robot, task: Task, progress: Progress
) -> tuple[SessionConfig, Task]:
    """Return the session with the plans of its phases, as far as their model is known."""
    known = [phase for phase in config.phases if phase.shape and not phase.identify]
    planned = with_plans(config, robot, task, known, progress)
    by_name = {phase.name: phase for phase in planned.phases}
    phases = tuple(by_name.get(phase.name, phase) for phase in config.phases)
    return dataclasses.replace(config, phases=phases), planned.task


def _started_on_the_reference(config: SessionConfig, task: Task) -> SessionConfig:
    """Return the session with the plant starting where the reference does, unless it says."""
    plant = config.nodes.get('plant', {})
    if task.trajectory is None or 'start' in plant:
        return config
    if list(plant.get('joints', task.joints)) != task.joints:
        return config
    start = task.trajectory.table(task.trajectory.duration)[1][0].tolist()
    return dataclasses.replace(config, nodes={**config.nodes, 'plant': {**plant, 'start': start}})


def new_folder(output: Path | None) -> Path:
    """Make a run's directory with its parts; one that exists is never written over.

    Raises
    ------
    ConfigError
        When `output` exists.
    """
    stamp = time.strftime('%Y%m%d-%H%M%S')
    candidates: Iterator[Path] = iter(
        [output]
        if output is not None
        else [Path('runs', stamp), *(Path('runs', f'{stamp}-{k}') for k in range(2, 100))]
    )
    for folder in candidates:
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        (folder / 'logs').mkdir()
        (folder / 'parameters').mkdir()
        return folder
    raise ConfigError('--output', [TAKEN.format(output)])


def _require_ros() -> None:
    try:
        import_module('denoc_ros.nodes.session_client')
    except ImportError as error:
        raise DenocError(NO_ROS.format(error)) from error


def _beams(config: SessionConfig, robot: Robot) -> dict[str, Any]:
    """Document the plant's beams for session.json: the changed paths, and words."""
    described = session_plant(config).overrides(robot.tree)
    plant, model = (
        description_in_words(robot.with_overrides(paths).tree if paths else robot.tree)
        for paths in (described, config.model)
    )
    given = config.nodes.get('plant', {})
    if given.get('engine') == 'mujoco':
        engine = required('export.mjcf', f'{config.path}: nodes.plant.engine')
        plant = f'MuJoCo, {given.get("segments") or engine.SEGMENTS} hinges per beam'
    return {'plant': described, 'beams': f'plant: {plant}; model: {model}'}


def _session_values(
    config: SessionConfig, environment: dict[str, str], command: str
) -> dict[str, Any]:
    """Document a session for session.json before it begins."""
    return {
        'name': config.path.stem,
        'configuration': str(config.path),
        'robot': str(config.robot),
        'gravity': list(config.gravity),
        'tip': config.tip,
        'environment': environment,
        'command': command,
        **({'model': dict(config.model)} if config.model else {}),
        'time': {'mode': config.time, 'why': WHY[config.time], 'begun_ns': time.time_ns()},
        'versions': versions(),
    }
