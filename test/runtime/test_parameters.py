"""One table declares, validates and documents. No graph."""

from __future__ import annotations

import inspect
import math
from pathlib import Path
from typing import Any

import pytest
import yaml

from denoc_ros.errors import ConfigError
from denoc_ros.estimation.fusion import FusionSettings
from denoc_ros.estimation.observer_settings import ObserverSettings
from denoc_ros.feedback.feedback_settings import FeedbackSettings
from denoc_ros.identification.tracking.tracker_settings import TrackerSettings
from denoc_ros.parts import parameter_table
from denoc_ros.runtime.parameters.parameter_table import ParameterTable
from denoc_ros.settings import Kind, Parameter, declared

TABLE = ParameterTable(
    [
        Parameter('rate', Kind.DOUBLE, 1000.0, 'a rate', 'Hz', 1.0, 10000.0),
        Parameter('count', Kind.INTEGER, 2, 'a count', '', 0, 9),
        Parameter('mode', Kind.STRING, 'a', 'a mode', choices=('a', 'b')),
        Parameter('gains', Kind.DOUBLES, [], 'gains', 'N m', 0.0),
        Parameter('names', Kind.STRINGS, [], 'names'),
        Parameter('on', Kind.BOOL, True, 'a switch', live=True),
        Parameter('limit', Kind.DOUBLE, math.inf, 'a limit', 's', positive=True, live=True),
        Parameter('beam.*', Kind.DOUBLE_OR_DOUBLES, None, 'an override', 'SI', live=True),
    ]
)


@pytest.mark.parametrize(
    ('name', 'given', 'taken'),
    [
        ('rate', 5, 5.0),
        ('limit', 3, 3.0),
        ('gains', 4, [4.0]),
        ('gains', (1, 2.5), [1.0, 2.5]),
        ('gains', [], []),
        ('names', ['x', 'y'], ['x', 'y']),
        ('beam.arm.y.ei', 7, 7.0),
        ('beam.arm.y.damping_ratio', [1, 2], [1.0, 2.0]),
    ],
)
def test_a_value_is_taken_as_the_rows_type(name: str, given: object, taken: object) -> None:
    accepted = TABLE.accept(name, given)
    assert accepted == taken
    assert type(accepted) is type(taken)


@pytest.mark.parametrize(
    ('name', 'given', 'says'),
    [
        ('rate', 0.5, "parameter 'rate' must be >= 1, <= 10000 Hz, got 0.5"),
        ('rate', 'fast', "'rate' must be a double Hz, got 'fast'"),
        ('rate', True, 'must be a double'),
        ('rate', math.nan, 'must be a number'),
        ('count', 2.0, 'must be an integer'),
        ('count', 10, '<= 9'),
        ('mode', 'c', 'must be one of a, b'),
        ('gains', [1.0, -1.0], '>= 0 N m'),
        ('gains', ['x'], 'must be a double array'),
        ('names', [1], 'must be a string array'),
        ('on', 1, 'must be a bool'),
        ('limit', 0.0, '> 0 s'),
        ('raet', 1.0, "did you mean 'rate'"),
        ('beam.', 1.0, 'one this node has'),
    ],
)
def test_a_bad_value_is_refused_with_what_must_hold(name: str, given: object, says: str) -> None:
    with pytest.raises(ValueError, match='must') as caught:
        TABLE.accept(name, given)
    assert says in str(caught.value)


def test_every_finding_comes_at_once() -> None:
    with pytest.raises(ConfigError) as caught:
        TABLE.settings({'rate': -1.0, 'mode': 'x', 'foo': 1}, '/node')
    assert len(caught.value.findings) == 3
    assert str(caught.value).startswith('/node: ')


def test_settings_are_defaults_with_what_is_given() -> None:
    settings = TABLE.settings({'rate': 5, 'beam.arm.y.ei': 2.0}, '/node')
    assert settings.number('rate') == 5.0
    assert settings.integer('count') == 2
    assert settings.text('mode') == 'a'
    assert settings.flag('on')
    assert settings.family('beam', 'joint') == {'beam.arm.y.ei': 2.0}
    assert settings.replace({'rate': 6.0}).number('rate') == 6.0


def test_read_only_parameters_stay_as_they_are() -> None:
    settings = TABLE.settings({}, '/node')
    assert TABLE.changes(settings, {'on': False, 'rate': 1000}) == {'on': False, 'rate': 1000.0}
    with pytest.raises(ValueError, match='read-only'):
        TABLE.changes(settings, {'rate': 10.0})


def test_the_documentation_has_every_row() -> None:
    text = TABLE.markdown()
    assert '| `rate` | double | `1000` | >= 1, <= 10000 | Hz | read-only | a rate |' in text
    assert '| `mode` | string | `a` | `a` \\| `b` |  | read-only | a mode |' in text
    assert '| `on` | bool | `true` |  |  | live | a switch |' in text
    assert len(text.splitlines()) == len(TABLE.rows) + 2


NODES = ('feedforward', 'plant', 'predictor', 'recorder', 'shaper', 'viewer')


@pytest.mark.ros
@pytest.mark.parametrize('node', NODES)
def test_every_default_is_one_the_row_accepts(node: str) -> None:
    table = parameter_table(node)
    names = [row.name for row in table.rows]
    assert len(set(names)) == len(names)
    for row in table.rows:
        if row.default is not None:
            assert row.accept(row.name, row.default) == row.default


@pytest.mark.ros
@pytest.mark.parametrize('node', ['feedforward', 'plant', 'shaper'])
def test_the_parameter_file_of_a_node_is_one_it_takes(node: str, repository: Path) -> None:
    text = (repository / 'config' / f'{node}.yaml').read_text()
    parameters = flatten(yaml.safe_load(text)[f'/**/{node}']['ros__parameters'])
    table = parameter_table(node)
    settings = table.settings(parameters, node)
    assert all(settings[name] == parameters[name] for name in parameters)


def flatten(values: dict[str, Any], prefix: str = '') -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, dict):
            flat.update(flatten(value, f'{prefix}{key}.'))
        else:
            flat[prefix + key] = value
    return flat


@pytest.mark.parametrize(
    'kind', [TrackerSettings, FusionSettings, ObserverSettings, FeedbackSettings]
)
def test_declared_settings_stand_in_the_docstring(kind: type) -> None:
    text = inspect.getdoc(kind) or ''
    for name, row in declared(kind).items():
        assert f'\n{name} : ' in text
        assert row.text in text
    assert text.count('Attributes\n') == 1
    assert text.index('Attributes\n') < text.index('Raises\n')
