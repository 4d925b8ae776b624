"""The files of a run: its bag and its session file."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.bags.reader import bag_folder
from denoc_ros.bags.run import LATEST_NS, RecordedPhase, parameter_changes, phases_of, read_marks
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import BagError
from denoc_ros.model.numbers import FAMILIES, Value, own_path, values_of
from denoc_ros.model.reading.findings import as_text
from denoc_ros.model.reading.mapping_reader import (
    NUMBER,
    TEXT,
    MappingReader,
    Rule,
    are_numbers,
    is_number,
)
from denoc_ros.types import Array

EARTH = (0.0, 0.0, -9.81)  # m/s^2, where nothing is said
FORMATS = ('.mcap', '.db3', '.csv', '.tsv', '.txt', '.dat', '.mat', '.json')
SESSION_FILE = 'session.json'
SIMULATED = 'simulate'  # kind of a session
STEPPED = 'simulated'  # mode of a session's time
SAME = 1e-9  # relative difference of numbers that are the same


def recording_name(path: Path) -> str:
    """Name of a recording: the file's without the suffix of its format.

    A dot in the name of a folder is no suffix: `run_0.55s` is not `run_0`.
    """
    name = path.resolve().name
    return next((name[: -len(end)] for end in FORMATS if name.lower().endswith(end)), name)


def find_bag(run_path: Path) -> Path:
    """Return the bag of a run's directory, or the bag itself."""
    if not run_path.exists():
        raise BagError(f'{run_path}: run must be a directory or a bag, got nothing there')
    return bag_folder(run_path)


def recorded_description(bag: Path) -> str:
    """Return the description of the robot that a bag holds.

    Raises
    ------
    BagError
        The bag holds none.
    """
    from denoc_ros.bags.reader import read_description

    if text := read_description(bag):
        return text
    raise BagError(f'{bag}: bag must hold the robot where --robot is not given, got none')


def robot_of_run(
    run_path: Path,
    source: str | Path | None = None,
    gravity: Sequence[float] | None = None,
    before_simulation: bool = False,
) -> Robot:
    """Return the robot of a run: the one in its bag as the session's nodes had it.

    Parameters
    ----------
    source : str or Path, optional
        A description in place of the recorded one: it stays as it is.
    gravity : (3,) sequence, optional
        [m/s^2]; default: the run's, else the earth's.
    before_simulation : bool
        Whether a simulated robot is the one of the file: the numbers that a simulation notes are
        those of the truth.

    Raises
    ------
    BagError, ConfigError, ModelError
        The run has no robot, or its session's numbers are not of this robot.
    """
    session = read_session(run_path)
    text = recorded_description(find_bag(run_path)) if source is None else source
    robot = load_robot(text, gravity=gravity or session.get('gravity', EARTH))
    keeps_file = source is not None or (before_simulation and session.get('kind') == SIMULATED)
    model = {} if keeps_file else session.get('model', {})
    return robot.with_overrides(model) if model else robot


def plant_of(robot: Robot, session: Mapping[str, Any]) -> Robot:
    """Return the robot whose states a run recorded: the file's as the session changed it.

    Raises
    ------
    ConfigError, ModelError
        The session's paths are not of this robot.
    """
    overrides = {**session.get('model', {}), **session.get('plant', {})}
    return robot.with_overrides(overrides) if overrides else robot


def read_session(run_path: Path) -> dict[str, Any]:
    """Return the session document of a run's directory, or of a bag of `denoc simulate`.

    It is empty where there is none.

    Raises
    ------
    BagError
        It is no JSON.
    ConfigError
        Its values are of other kinds than those that sessions have; every finding.
    """
    from denoc_ros.bags.reader import SESSION_ATTACHMENT, read_attachment

    file = run_path / SESSION_FILE
    try:
        if file.is_file():
            text = file.read_bytes()
        else:
            text = read_attachment(run_path, SESSION_ATTACHMENT)
    except BagError:
        return {}
    try:
        session = json.loads(text)
        # Python's JSON has numbers and characters that no page and no other JSON can have.
        json.dumps(session, allow_nan=False, ensure_ascii=False).encode()
    except (ValueError, RecursionError) as error:
        raise BagError(f'{run_path}: {SESSION_FILE} must be JSON, got: {error}') from error
    reader = _SessionReader()
    document = reader.session(session)
    reader.finish(f'{run_path}: {SESSION_FILE}')
    return document


def recorded_phases(run_path: Path, names: Sequence[str] = ()) -> tuple[RecordedPhase, ...]:
    """Return the phases of a run's directory or of a bag in order: all, or those of some names.

    A phase with a reference begins with that.

    Raises
    ------
    BagError, ConfigError
        The run cannot be read, or has no phase of a name.
    """
    noted = read_session(run_path).get('phases', ())
    known = phases_of(noted, [] if noted else read_marks(find_bag(run_path)))
    if known[0].name and all(phase.plant is None for phase in known):
        known = _with_changed_plants(find_bag(run_path), known)
    if missing := set(names) - {phase.name for phase in known}:
        phases = ', '.join(repr(phase.name) for phase in known if phase.name) or 'none'
        raise BagError(
            f'{run_path}: --phase must be a phase of the run ({phases}), '
            f'got {", ".join(map(repr, sorted(missing)))}'
        )
    return tuple(phase for phase in known if not names or phase.name in names)


def _with_changed_plants(bag: Path, phases: Sequence[RecordedPhase]) -> tuple[RecordedPhase, ...]:
    """Return phases with the plant's numbers that parameter events have changed before each."""
    changes = parameter_changes(bag, 'plant')
    found = []
    for phase in phases:
        plant: dict[str, Any] = {}
        for stamp_ns, values in changes:
            if stamp_ns <= phase.begin_ns:
                plant.update({p: v for p, v in values.items() if p.split('.')[0] in FAMILIES})
        # the damping that a node derives from damping ratios is not what was changed
        rigid = {f'{path.rpartition(".")[0]}.damping' for path in plant if path.endswith('.ei')}
        kept = {path: value for path, value in plant.items() if path not in rigid}
        found.append(replace(phase, plant=kept or None))
    return tuple(found)


def plant_differences(
    robot: Robot, plant: Mapping[str, Any]
) -> dict[str, tuple[Value | None, Value | None]]:
    """Return by dotted path the numbers of a plant and of a model that differ.

    What a payload without mass has counts for nothing.
    """
    model = values_of(robot.tree)
    given = {own_path(path, model): value for path, value in plant.items()}
    found = {}
    for path, value in given.items():
        numbers = np.atleast_1d(np.asarray(value, dtype=np.float64))
        mine = model.get(path)
        family, _, rest = path.partition('.')
        mass = f'payload.{rest.rpartition(".")[0]}.mass'
        if family == 'payload' and not (given.get(mass, 0.0) or model.get(mass, 0.0)):
            continue
        if mine is None or not _agree(numbers, np.atleast_1d(np.asarray(mine))):
            plain = numbers.tolist()
            found[path] = (plain[0] if len(plain) == 1 else plain, mine)
    return found


def _agree(numbers: Array, others: Array) -> bool:
    """Say whether numbers are the same; one number stands for several."""
    one, other = (each if len(each) > 1 else each[0] for each in (numbers, others))
    return np.shape(one) in ((), np.shape(other)) and bool(
        np.allclose(one, other, rtol=SAME, atol=0.0)
    )


class _SessionReader(MappingReader):
    """Checks the document that a session or a simulation wrote, as far as it is read."""

    def session(self, document: Any) -> dict[str, Any]:
        """Return the values that are given: null gives none."""
        given = self.mapping('the document', document).items()
        values = {name: value for name, value in given if value is not None}
        self.check('', values, SESSION_RULES)
        for name in ('model', 'plant'):
            self.check_all(name, values.get(name), OVERRIDE)
        self.check_all('versions', values.get('versions'), TEXT)
        self.check('time.', self.mapping('time', values.get('time')), TIME_RULES)
        for whose, phase in self.entries('phases', values.get('phases')):
            self._phase(whose, phase)
        for whose, note in self.entries('notes', values.get('notes')):
            self.check('', {whose: note}, {whose: TEXT})
        return values

    def _phase(self, whose: str, phase: Any) -> None:
        values = self.mapping(whose, phase)
        self.check(f'{whose}.', {**dict.fromkeys(PHASE_RULES), **values}, PHASE_RULES)
        for name in ('model', 'plant'):
            self.check_all(f'{whose}.{name}', values.get(name), OVERRIDE)
        self._identified(f'{whose}.identified', values.get('identified'))
        begin_ns: Any = values.get('begin_ns')
        end_ns: Any = values.get('end_ns')
        if _is_stamp(begin_ns) and _is_stamp(end_ns) and end_ns < begin_ns:
            self.fail(f'{whose}.end_ns', f'be {begin_ns} or more', end_ns)

    def _identified(self, whose: str, value: Any) -> None:
        """Check what a phase was told by the recording of another."""
        if value is None:
            return
        found = {'from': None, **self.mapping(whose, value)}
        self.check(f'{whose}.', {'from': found['from']}, {'from': TEXT})
        for number, given in self.entries(f'{whose}.numbers', found.get('numbers')):
            values = {**dict.fromkeys(NUMBER_RULES), **self.mapping(number, given)}
            self.check(f'{number}.', values, NUMBER_RULES)


def _is_stamp(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < LATEST_NS


STAMP: Rule = (_is_stamp, 'a whole number of ns from 0 to 2^63')
OVERRIDE: Rule = (lambda value: as_text(value) is not None, 'a number, a text or some of them')
SESSION_RULES: dict[str, Rule] = {
    **dict.fromkeys(
        ('kind', 'name', 'robot', 'tip', 'command', 'scenario', 'failure', 'beams'), TEXT
    ),
    'gravity': (
        lambda value: are_numbers(value) and len(value) == 3,
        'three finite numbers [m/s^2]',
    ),
    'geometric_stiffness': (lambda value: isinstance(value, bool), 'true or false'),
}
TIME_RULES: dict[str, Rule] = {
    'mode': TEXT, 'why': TEXT, 'begun_ns': STAMP, 'factor': NUMBER,
}  # fmt: skip
NUMBER_RULES: dict[str, Rule] = {
    'path': TEXT, 'verdict': TEXT, 'start': NUMBER, 'value': NUMBER,
    'interval': (
        lambda value: isinstance(value, list)
        and len(value) == 2
        and all(each is None or is_number(each) for each in value),
        'two finite numbers, or null for them',
    ),
}  # fmt: skip
PHASE_RULES: dict[str, Rule] = {
    'name': TEXT,
    'begin_ns': STAMP,
    'end_ns': (lambda value: value is None or _is_stamp(value), f'null or {STAMP[1]}'),
}
