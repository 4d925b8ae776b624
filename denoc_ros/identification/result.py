"""Results of identification as plain values, and their files."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from denoc_ros.bags.digest import file_hash
from denoc_ros.errors import ConfigError, IdentificationError
from denoc_ros.identification.analysis import DecayAnalysis
from denoc_ros.identification.channel import Channel, Reading
from denoc_ros.identification.modes import Modes, strongest
from denoc_ros.identification.quality import Quality
from denoc_ros.output_files import write_text
from denoc_ros.yaml_text import read_yaml_file

if TYPE_CHECKING:
    from denoc_ros.identification.damping import Assigned

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

Document = dict[str, Any]


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
        'calibration': {'gain': channel.gain, 'offset': channel.offset, 'unit': channel.unit},
    }


def _clock_of(channel: Channel) -> str:
    """Clock of a table: a column and its unit, or a rate."""
    if not channel.time:
        return f'{channel.rate:g} Hz'
    unit = f' in {channel.time_unit}' if channel.time_unit not in ('', 's') else ''
    return f'{channel.time}{unit}'


def quality_of(quality: Quality) -> Document:
    """Return the quality of a record."""
    values = {field.name: getattr(quality, field.name) for field in dataclasses.fields(quality)}
    values['clipped'] = int(np.count_nonzero(quality.clipped))
    return {name: plain(value) for name, value in values.items()}


def modal_result(
    reading: Reading,
    analysis: DecayAnalysis,
    coefficients: Mapping[int, Assigned],
    versions: Mapping[str, str],
    model: Mapping[str, Any],
    asked: Sequence[int] | None = None,
) -> Document:
    """Return all that is kept of an identification of modes.

    Parameters
    ----------
    reading : Reading
        The record.
    analysis : DecayAnalysis
        What came out of it.
    coefficients : mapping
        Place of a mode -> the amplitude of a model that it determines; may be empty.
    versions : mapping
        Of the packages.
    model : mapping
        Of what robot the coefficients are, and where its joints stood; may be empty.
    asked : sequence of int, optional
        Places of the modes that the verdict is of; default: the strongest.
    """
    modes = analysis.modes
    of = strongest(modes.frequency, modes.energy) if asked is None else tuple(asked)
    document = {
        'kind': 'modal',
        'source': source_of(reading),
        'window': {
            'begin_s': modes.start,
            'end_s': modes.stop,
            'by': analysis.window_by,
        },
        'quality': quality_of(analysis.quality),
        'method': METHOD,
        'modes': [
            {
                **_mode(modes, k),
                'asked': k in of,
                'checks': [_check(check) for check in analysis.checks[k]],
                **({'coefficient': _coefficient(coefficients[k])} if k in coefficients else {}),
            }
            for k in range(len(modes.frequency))
        ],
        'lines': [
            {name: plain(value) for name, value in dataclasses.asdict(line).items()}
            for line in modes.lines
        ],
        'noise': modes.noise,
        'offset': modes.offset,
        'drift_per_s': modes.drift,
        **({'model': dict(model)} if model else {}),
        'verdict': modes.status_of(of),
        'remarks': list(modes.remarks),
        'reasons': [*modes.remarks, *(one for k in of for one in modes.reasons[k])],
        'versions': dict(versions),
    }
    return dict(plain(document))


def write_result(folder: Path, document: Mapping[str, Any]) -> None:
    """Write result.yaml, and modes.csv where the result has modes, into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    text = yaml.safe_dump(plain(document), sort_keys=False, allow_unicode=True, width=100)
    write_text(folder / RESULT_FILE, text)
    if document['kind'] == 'modal':
        table = io.StringIO(newline='')
        writer = csv.writer(table)
        writer.writerow(TABLE_COLUMNS)
        writer.writerows(table_rows(document))
        write_text(folder / TABLE_FILE, table.getvalue())


def read_result(path: Path) -> Document:
    """Return a result from its file, or from the folder it is in.

    Raises
    ------
    IdentificationError
        When it cannot be read or is no result.
    """
    file = path / RESULT_FILE if path.is_dir() else path
    try:
        document = read_yaml_file(file)
    except ConfigError as error:
        raise IdentificationError(f'{file}: result must be readable, got: {error}') from error
    if not isinstance(document, dict) or document.get('kind') not in ('modal', 'joint', 'forced'):
        raise IdentificationError(
            f'{file}: result must be one that denoc identify wrote, got something else'
        )
    return document


def table_rows(document: Mapping[str, Any]) -> list[list[Any]]:
    """Return the rows of modes.csv, in the order of TABLE_COLUMNS."""
    return [
        [
            mode['frequency_hz'],
            mode['damping_ratio'],
            *mode['interval'],
            mode['bound'],
            mode['amplitude'],
            mode['snr_db'],
            mode['verdict'],
        ]
        for mode in document['modes']
    ]


def _mode(modes: Modes, k: int) -> Document:
    curve = modes.curves[k]
    values: Document = {
        'frequency_hz': modes.frequency[k],
        'frequency_deviation_hz': modes.frequency_deviation[k],
        'damping_ratio': modes.damping_ratio[k],
        'interval': modes.interval[k],
        'formal_interval': modes.formal_interval[k],
        'window_interval': modes.window_interval[k],
        'bound': modes.bound[k],
        'amplitude': modes.amplitude[k],
        'phase_rad': modes.phase[k],
        'snr_db': modes.snr_db[k],
        'verdict': modes.verdict[k],
        'reasons': modes.reasons[k],
    }
    if curve is not None:
        values['amplitude_dependent'] = curve.dependent
        values['windows'] = {
            'time_s': curve.time,
            'amplitude': curve.amplitude,
            'frequency_hz': curve.frequency,
            'damping_ratio': curve.damping_ratio,
            'deviation': curve.deviation,
        }
    return {name: plain(value) for name, value in values.items()}


def _check(check: Any) -> Document:
    return {name: plain(value) for name, value in dataclasses.asdict(check).items()}


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


def plain(value: Any) -> Any:
    """Return a value of types that YAML and JSON have; a number that is not finite is None."""
    if isinstance(value, np.ndarray):
        return [plain(entry) for entry in value.tolist()]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [plain(entry) for entry in value]
    return value
