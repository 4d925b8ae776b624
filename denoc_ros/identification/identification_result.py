"""Results of identification as plain values, and their files."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from denoc_ros.bags.digest import file_hash
from denoc_ros.bags.reader import read_description
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.errors import ConfigError, DenocError, IdentificationError
from denoc_ros.identification.decay.analysis import DecayAnalysis, analyse_decay
from denoc_ros.identification.decay.channel import (
    Channel,
    Reading,
    channels_of,
    joint_positions,
    read_record,
)
from denoc_ros.identification.decay.damping import USABLE, Assigned, assign_damping, configuration
from denoc_ros.identification.decay.modes import DOUBTFUL, GOOD, Modes, strongest
from denoc_ros.identification.decay.record_segments import standing_spans
from denoc_ros.identification.decay.records import Quality, assess
from denoc_ros.identification.tables.tables import is_table
from denoc_ros.model.reading.mapping_reader import NUMBER, TEXT, MappingReader, Rule, is_number
from denoc_ros.output_files import Document, plain, write_text
from denoc_ros.yaml_text import read_yaml_file

RESULT_FILE = 'result.yaml'
TABLE_FILE = 'modes.csv'
SCALING = 'shape functions with max |s| = 1 on the beam'
METHOD = 'matrix pencil, then least squares of damped cosines, offset and drift; order by BIC'
TABLE_COLUMNS = (
    'frequency_hz',
    'damping_ratio',
    'interval_low',
    'interval_high',
    'bound',
    'amplitude',
    'snr_db',
    'verdict',
)

# keys of values with units
KEYS = {
    'frequency': 'frequency_hz',
    'frequency_deviation': 'frequency_deviation_hz',
    'phase': 'phase_rad',
    'time': 'time_s',
    'duration': 'duration_s',
    'rate': 'rate_hz',
    'longest_gap': 'longest_gap_s',
}
OF_MODE = (
    *('frequency', 'frequency_deviation', 'damping_ratio'),
    *('interval', 'formal_interval', 'window_interval', 'bound'),
    *('amplitude', 'phase', 'snr_db', 'verdict', 'reasons'),
)
OF_WINDOWS = ('time', 'amplitude', 'frequency', 'damping_ratio', 'deviation')


def source_of(reading: Reading) -> Document:
    """Source of a record: file, its hash, channel, stamps, calibration."""
    channel = reading.channel
    return {
        'file': str(reading.path),
        'sha256': file_hash(reading.path),
        'topic': channel.topic,
        'field': channel.field,
        'quantity': channel.quantity if channel.topic else '',
        'stamp': channel.stamp if channel.topic else _clock_of(channel),
        'rows': reading.rows,
        'used_rows': len(reading.record.t),
        'calibration': {'gain': channel.gain, 'offset': channel.offset, 'unit': channel.unit},
    }


def _clock_of(channel: Channel) -> str:
    """Clock of a table: a column and its unit, or a rate."""
    if not channel.time:
        return f'{channel.rate:g} Hz'
    unit = f' in {channel.time_unit}' if channel.time_unit not in ('', 's') else ''
    return f'{channel.time}{unit}'


def doubted(document: Document, reading: Reading) -> Document:
    """Return a result that is not good where too few rows of its recording are used."""
    if not reading.doubt:
        return document
    verdict = DOUBTFUL if document['verdict'] == GOOD else document['verdict']
    return {**document, 'verdict': verdict, 'reasons': [*document['reasons'], reading.doubt]}


def quality_of(quality: Quality) -> Document:
    """Return the quality of a record."""
    values = {field.name: getattr(quality, field.name) for field in dataclasses.fields(quality)}
    values['clipped'] = int(np.count_nonzero(quality.clipped))
    return {name: plain(value) for name, value in values.items()}


@dataclass(frozen=True)
class DecayOptions:
    """Part of a recording to identify, and its robot."""

    channel: Channel  # the signal
    band: tuple[float, float]  # frequencies of the modes that the verdict is of [Hz]
    count: int | None  # how many they are, the strongest first; as `strongest` takes it
    robot: str  # name of the robot's file; '' for the robot in the bag, if there is one
    file: Path | None  # where that file is
    # positions of joints [rad, m]; the others' are those recorded, else 0
    joints: Mapping[str, float]
    held: bool  # whether the joints were held during the decay
    gravity: tuple[float, float, float]  # in the base frame [m/s^2]


def identify_decay(path: Path, options: DecayOptions) -> tuple[Document, DecayAnalysis]:
    """Return the result for one recording of a free decay, and the analysis it is from."""
    channel = options.channel
    reading = read_record(path, channel)
    given = channel.begin > 0.0 or math.isfinite(channel.end)
    standing = standing_spans(reading) if options.held else ()
    analysis = analyse_decay(reading.record, given, standing, reading.doubt)
    coefficients, model = _model_of(options, reading, analysis)
    modes = analysis.modes
    asked = strongest(modes.frequency, modes.energy, options.band, options.count)
    return _modal_result(reading, analysis, coefficients, model, asked), analysis


def _model_of(
    options: DecayOptions, reading: Reading, analysis: DecayAnalysis
) -> tuple[dict[int, Assigned], Document]:
    """Return the amplitudes of the model that the good modes determine, and which model it is.

    Without a robot, where the joints stood is all.
    """
    modes = analysis.modes
    measured = {**joint_positions(reading, modes.start, modes.stop), **options.joints}
    source: str | Path | None = options.file
    if source is None and not is_table(reading.path):
        source = read_description(reading.path) or None
    if source is None:
        return {}, {'joints': measured} if measured else {}
    robot = load_robot(source, gravity=options.gravity)
    joints = {name: measured[name] for name in robot.joint_names if name in measured}
    joints.update(options.joints)
    model: Document = {
        'robot': robot.tree.name,
        'file': options.robot or 'attached to the bag',
        'joints': joints,
        'held': options.held,
        'gravity': list(options.gravity),
    }
    usable = [k for k, verdict in enumerate(modes.verdict) if verdict in USABLE]
    if not usable:
        return {}, model
    try:
        assigned = assign_damping(
            robot,
            configuration(robot, joints),
            modes.frequency[usable],
            modes.damping_ratio[usable],
            options.held,
            modes.amplitude[usable],
        )
    except DenocError as error:
        return {}, {**model, 'left_out': str(error)}
    return {usable[one.mode]: one for one in assigned}, model


def _modal_result(
    reading: Reading,
    analysis: DecayAnalysis,
    coefficients: Mapping[int, Assigned],
    model: Mapping[str, Any],
    asked: Sequence[int],
) -> Document:
    """Return a result of modes.

    Parameters
    ----------
    coefficients : mapping
        Place of a mode -> the amplitude of a model that it determines; may be empty.
    model : mapping
        Of what robot the coefficients are, and where its joints stood; may be empty.
    asked : sequence of int
        Places of the modes that the verdict is of.
    """
    modes = analysis.modes
    document = {
        'kind': 'modal',
        'source': source_of(reading),
        'window': {'begin_s': modes.start, 'end_s': modes.stop, 'by': analysis.window_by},
        'quality': quality_of(analysis.quality),
        'method': METHOD,
        'modes': [
            {
                **_mode(modes, k),
                'asked': k in asked,
                'checks': [dataclasses.asdict(check) for check in analysis.checks[k]],
                **({'coefficient': _coefficient(coefficients[k])} if k in coefficients else {}),
            }
            for k in range(len(modes.frequency))
        ],
        'lines': [dataclasses.asdict(line) for line in modes.lines],
        'noise': modes.noise,
        'offset': modes.offset,
        'drift_per_s': modes.drift,
        **({'model': dict(model)} if model else {}),
        'verdict': modes.status_of(asked),
        'remarks': modes.remarks,
        'reasons': [*modes.remarks, *(one for k in asked for one in modes.reasons[k])],
    }
    return dict(plain(document))


def describe(path: Path, channel: Channel) -> list[Document]:
    """Return one row of quality per signal that the channel leaves open.

    Raises
    ------
    BagError
        When the file cannot be read, or has no such signal.
    """
    chosen = [channel]
    if not channel.field:
        chosen = [
            replace(channel, topic=one.topic, field=one.field, quantity=one.quantity)
            for one in channels_of(path)
            if channel.topic in ('', one.topic)
        ]
    return [_signal(path, one) for one in chosen]


def _signal(path: Path, channel: Channel) -> Document:
    try:
        reading = read_record(path, channel)
    except DenocError as error:
        return {'signal': channel.name, 'problem': str(error)}
    row = {'signal': reading.channel.name, **quality_of(assess(reading.record))}
    return {KEYS.get(key, key): value for key, value in row.items()}


def write_result(folder: Path, document: Mapping[str, Any]) -> None:
    """Write result.yaml, and modes.csv where the result has modes, into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    text = yaml.safe_dump(plain(document), sort_keys=False, allow_unicode=True, width=100)
    write_text(folder / RESULT_FILE, text)
    if document['kind'] == 'modal':
        table = io.StringIO(newline='')
        writer = csv.writer(table)
        writer.writerow(TABLE_COLUMNS)
        for mode in map(flat_mode, document['modes']):
            writer.writerow([mode[name] for name in TABLE_COLUMNS])
        write_text(folder / TABLE_FILE, table.getvalue())


def read_result(path: Path) -> Document:
    """Return a result from its file, or from the folder it is in."""
    file = path / RESULT_FILE if path.is_dir() else path
    try:
        document = read_yaml_file(file)
    except ConfigError as error:
        raise IdentificationError(f'{file}: result must be readable, got: {error}') from error
    if not isinstance(document, dict) or document.get('kind') not in ('modal', 'joint', 'forced'):
        raise IdentificationError(
            f'{file}: result must be one that denoc identify wrote, got something else'
        )
    reader = _ResultReader()
    reader.result(document)
    if reader.findings:
        raise IdentificationError('\n'.join(f'{file}: {each}' for each in reader.findings))
    return document


class _ResultReader(MappingReader):
    """Checks the values of a result that verbs read back."""

    def result(self, document: Document) -> None:
        if document['kind'] == 'modal':
            for whose, mode in self.entries('modes', document.setdefault('modes', [])):
                # A mode without an interval is one of which the interval is not known.
                known = {'interval': [None, None], **self.mapping(whose, mode)}
                values = {**dict.fromkeys(MODE_RULES), **known}
                self.check(f'{whose}.', values, MODE_RULES)
                if not self.findings:
                    numbers = {name: _number(values[name]) for name in MAY_BE_NULL}
                    mode.update(numbers, interval=[_number(end) for end in values['interval']])
        model = self.mapping('model', document.setdefault('model', {}))
        self.check_all('model.joints', model.get('joints'), NUMBER)
        terms = self.mapping('terms', document.setdefault('terms', {}))
        for name, term in terms.items():
            value = {'value': None, **self.mapping(f'terms.{name}', term)}
            self.check(f'terms.{name}.', value, {'value': NUMBER})


def _is_number(value: Any) -> bool:
    return value is None or is_number(value)


def _is_interval(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(map(_is_number, value))


def _number(value: float | None) -> float:
    """Return a number of a document, in which null stands for one that is not finite."""
    return math.nan if value is None else value


MAY_BE_NULL = ('damping_ratio', 'amplitude')
MODE_RULES: dict[str, Rule] = {
    'frequency_hz': (lambda value: is_number(value) and value > 0.0, 'a number > 0 Hz'),
    **dict.fromkeys(MAY_BE_NULL, (_is_number, 'a finite number or null')),
    'interval': (_is_interval, 'two finite numbers, or null for them'),
    'verdict': TEXT,
}


def flat_mode(mode: Mapping[str, Any]) -> Document:
    """Return a mode of a result with the ends of its interval as numbers of their own."""
    low, high = mode['interval']
    return {**mode, 'interval_low': low, 'interval_high': high}


def mode_values(found: Any, k: int, names: Sequence[str]) -> Document:
    """Return attributes of mode k by their keys in a result."""
    return {KEYS.get(name, name): getattr(found, name)[k] for name in names}


def _mode(modes: Modes, k: int) -> Document:
    values, curve = mode_values(modes, k, OF_MODE), modes.curves[k]
    if curve is not None:
        values['amplitude_dependent'] = curve.dependent
        values['windows'] = {KEYS.get(name, name): getattr(curve, name) for name in OF_WINDOWS}
    return values


def _coefficient(one: Assigned) -> Document:
    return {
        'value': one.coefficient,
        'unit': one.unit,
        'of': one.coordinate,
        'scaling': SCALING,
        'damping_ratio_at_fixed_root': one.damping_ratio,
        'path': one.path,
        'place': one.place,
        'model_frequency_hz': one.model_hz,
        'share_of_strain_energy': one.share,
    }
