"""Names from strangers reach a terminal without their control characters."""

from __future__ import annotations

import logging
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from denoc_ros.bags.writer import BagWriter
from denoc_ros.cli.main import main
from denoc_ros.cli.progress import Progress
from denoc_ros.terminal_text import say, visible, visible_cell, visible_record
from denoc_ros.text_table import aligned

JOINT_STATE = 'sensor_msgs/msg/JointState'
# Sets the title of the window, colours, in seven and eight bits, deletes, and turns the direction.
EVIL = 'a\x1b]0;owned\x07\x1b[31m\x9b1A\x7f\x00\r\u202eb\u2066'
HARMFUL = re.compile('[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]')


def test_control_characters_are_shown_and_all_others_stay() -> None:
    for code in (*range(0x100), 0x061C, *range(0x2000, 0x2070), 0x1F600):
        text = f'x{chr(code)}y'
        shown = visible(text)
        assert not HARMFUL.search(shown)
        if not HARMFUL.search(text):
            assert shown == text
        else:
            assert shown.encode().decode('unicode_escape') == text
        assert len(visible_cell(text).splitlines()) == 1
        assert visible(shown) == shown


def test_a_table_has_one_line_for_each_row() -> None:
    rows = [['name', 'rate'], ['a\n\x1b[2Jb', '5'], ['c', '6']]
    lines = aligned(rows).splitlines()
    assert len(lines) == len(rows)
    assert len({line.rstrip().rindex(' ') for line in lines if line.split()[-1] in '56'}) == 1


def test_the_log_and_the_progress_are_shown_so_too(capsys: pytest.CaptureFixture[str]) -> None:
    say(EVIL, file=sys.stderr)
    Progress().say(EVIL)
    with Progress().phase(EVIL, 1.0):
        pass
    log = logging.Logger('foreign')
    handler = logging.StreamHandler()
    handler.addFilter(visible_record)
    log.addHandler(handler)
    log.warning('topic %s', EVIL)
    said = capsys.readouterr()
    assert not HARMFUL.search(said.out + said.err)
    assert said.err.count('\\x1b]0;owned') == 4


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording whose topic and joint have harmful names."""
    path = tmp_path_factory.mktemp('bag') / 'run'
    with BagWriter(path, 'none') as writer:
        writer.add_topic(f'/{EVIL}', JOINT_STATE)
        for k in range(400):
            t = 0.01 * k
            y = float(np.exp(-0.5 * t) * np.sin(30.0 * t))
            writer.write_message(
                f'/{EVIL}', 10**7 * k, name=[f'j{EVIL}'], position=[y], velocity=[y], effort=[y]
            )
    return path


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """Return a table of which a column has a harmful name."""
    path = tmp_path / 'run.csv'
    t = 0.01 * np.arange(400)
    y = np.exp(-0.5 * t) * np.sin(30.0 * t)
    name = EVIL.replace('\r', '').replace('\x00', '')
    rows = '\n'.join(f'{a:.3f},{b:.6f}' for a, b in zip(t, y, strict=True))
    path.write_text(f'time,{name}\n{rows}\n', encoding='utf-8')
    return path


@pytest.mark.parametrize(
    'words',
    [
        ['recover'],
        ['identify', 'info'],
        ['identify', 'segment'],
        ['identify', 'modal'],
        ['replay'],
        ['report'],
    ],
    ids=' '.join,
)
@pytest.mark.parametrize('kind', ['bag', 'table'])
def test_no_verb_prints_a_control_character_of_a_file(
    words: list[str],
    kind: str,
    bag: Path,
    table: Path,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    source = bag if kind == 'bag' else table
    out = ['-o', str(tmp_path / 'out')] if words[0] != 'identify' else []
    main([*words, str(source), *out])
    said = capfd.readouterr()
    assert said.out + said.err
    assert not HARMFUL.search(said.out + said.err), ascii(said.out + said.err)


@pytest.mark.parts('identification')
def test_a_harmful_name_is_shown_escaped(bag: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(['identify', 'info', str(bag)]) in (0, 1, 2)
    assert r'\x1b]0;owned\x07\x1b[31m' in capfd.readouterr().out


def test_a_harmful_argument_is_shown_escaped(capfd: pytest.CaptureFixture[str]) -> None:
    for words in ([EVIL], ['check', EVIL], ['check', f'--{EVIL}', 'a'], ['up', EVIL]):
        assert main(words) == 1
        said = capfd.readouterr().err
        assert not HARMFUL.search(said), ascii(said)
        assert 'owned' in said
