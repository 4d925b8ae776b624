"""YAML of anybody: values, or one error with the place; never a full memory."""

from __future__ import annotations

import resource
import time
from pathlib import Path

import pytest

from denoc_ros import yaml_text
from denoc_ros.cli.arguments import overrides_of
from denoc_ros.cli.main import main
from denoc_ros.cli.session.session_config import load_config
from denoc_ros.errors import ConfigError
from denoc_ros.export.dh_system import load_system
from denoc_ros.runtime.parameters.parameter_table import shared_names
from denoc_ros.yaml_text import MOST_ALIASED, MOST_LEVELS, YamlError, load_yaml
from denoc_ros.yaml_text import read_yaml_file as read

ALIASES = '\n'.join(
    ['a0: &a0 [1, 1]', *(f'a{k}: &a{k} [*a{k - 1}, *a{k - 1}]' for k in range(1, 40))]
)
MERGES = '\n'.join(
    ['a0: &a0 {x: 1}', *(f'a{k}: &a{k}\n  <<: [*a{k - 1}, *a{k - 1}]' for k in range(1, 26))]
)
REFUSED = {
    'aliases': (ALIASES, f'aliases must repeat at most {MOST_ALIASED} values'),
    'merge keys': (MERGES, f'aliases must repeat at most {MOST_ALIASED} values'),
    'brackets': ('[' * 20_000, f'line 1, column 61: levels must be at most {MOST_LEVELS}'),
    'long integer': ('a: ' + '9' * 10_000, 'line 1, column 4: an integer must fit 64 bits, got'),
    'integer of 30 digits': ('a: ' + '9' * 30, 'an integer must fit 64 bits'),
    'binary integer': ('a: 0b' + '1' * 5000, 'an integer must fit 64 bits'),
    'a list in itself': ('&a [*a]', 'line 1, column 5: an alias must not be inside'),
    'a mapping in itself': ('&a {b: *a}', 'an alias must not be inside of its own anchor'),
    'a key that is none': ('~: 3', 'a key must be text, got None'),
    'a list as key': ('? [1]\n: 2', 'the text must be YAML, got'),
    'bytes': ('!!binary aGk=', 'could not determine a constructor'),
    'an object': ('!!python/object/apply:os.getcwd []', 'could not determine a constructor'),
    'a word for a number': ('!!float abc', 'a number must be one'),
    'a word for a truth': ('!!bool abc', 'a truth value must be true or false'),
    'a zero byte': ('a: \0', 'the text must be YAML'),
    'tabs': ('a:\n\t- b', 'the text must be YAML'),
}


@pytest.mark.parametrize(('text', 'rule'), REFUSED.values(), ids=REFUSED)
def test_text_that_would_hurt_is_one_error_with_its_place(text: str, rule: str) -> None:
    with pytest.raises(YamlError) as told:
        load_yaml(text)
    assert rule in str(told.value)
    assert 'line 1' in str(told.value) or '\n' in text or len(text) > 1000 or '\0' in text


def test_the_number_of_values_has_a_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(yaml_text, 'MOST_VALUES', 1000)
    assert len(load_yaml(f'[{"0," * 999}]')) == 999
    with pytest.raises(YamlError, match='values must be at most 1000'):
        load_yaml(f'[{"0," * 1000}]')


@pytest.mark.parametrize('text', [ALIASES, MERGES], ids=['aliases', 'merge keys'])
def test_some_hundred_bytes_take_neither_memory_nor_time(text: str) -> None:
    assert len(text) < 1200
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began = time.process_time()
    with pytest.raises(YamlError):
        load_yaml(text)
    assert time.process_time() - began < 2.0  # 0.01; without bounds it did not end
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # KiB


def test_dates_are_text_and_exponents_are_numbers() -> None:
    assert load_yaml('[2024-01-01, 1e5, 9.0e4, 0x10, 1_000]') == [
        '2024-01-01', 1e5, 9e4, 16, 1000,
    ]  # fmt: skip


def test_aliases_and_merge_keys_of_use_are_read() -> None:
    text = 'base: &base {a: 1, b: 2}\none: {<<: *base, b: 3}\ntwo: *base'
    assert load_yaml(text)['one'] == {'a': 1, 'b': 3}
    assert load_yaml(text)['two'] == {'a': 1, 'b': 2}


@pytest.mark.parts('identification')
@pytest.mark.parametrize('text', [ALIASES, MERGES, '&a {robot: *a}', 'robot: ' + '[' * 20_000])
def test_every_file_of_yaml_is_read_within_the_bounds(
    tmp_path: Path, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / 'given.yaml'
    file.write_text(text)
    for verb in (
        ['up', str(file)],
        ['dh', str(file), '-o', str(tmp_path / 'a.urdf')],
        ['identify', 'compare', str(file)],
    ):
        assert main(verb) == 1
        said = capsys.readouterr().err
        assert str(file) in said
        assert len(said) < 1000
    with pytest.raises(ConfigError):
        load_system(file)
    assert shared_names(['--ros-args', '--params-file', str(file)], '/node') == set()


@pytest.mark.parametrize('value', ['&a [*a]', '9' * 5000, '[' * 2000, '!!binary aGk=', '*x'])
def test_a_value_on_the_command_line_has_the_same_bounds(repository: Path, value: str) -> None:
    setting = f'payload.tip.mass={value}'
    with pytest.raises(ConfigError, match=r'--set payload\.tip\.mass: '):
        overrides_of([setting], {})
    with pytest.raises(ConfigError, match=r'--set payload\.tip\.mass: '):
        load_config(repository / 'config' / 'canadarm.yaml', [setting])


def test_a_file_that_is_no_text_is_named(tmp_path: Path) -> None:
    file = tmp_path / 'a.yaml'
    file.write_bytes(b'\xff\xfe\x00')
    with pytest.raises(ConfigError, match='in UTF-8'):
        read(file)
    with pytest.raises(ConfigError, match='must be readable'):
        read(tmp_path)
