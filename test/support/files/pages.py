"""A page of documentation as the sequence of its snippets.

What stands in a comment right before a block says how it is taken; keys are

    <!-- snippet: file=arm.urdf -->          also written to this file, for later snippets
    <!-- snippet: robot=arm.urdf -->         the robot that a scenario is for
    <!-- snippet: status=2 -->               the exit status of its commands, 0 where there is none
    <!-- snippet: add="--duration 1" -->     what the test adds to its commands, to be short
    <!-- snippet: output -->                 each line is in the output of the block before
    <!-- snippet: parse because="..." -->    commands are understood, but not run
    <!-- snippet: skip because="..." -->     not looked at

and a comment that begins `<!-- snippet: python` holds code that the page's next block presumes.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

KEYS = {'file', 'robot', 'status', 'add', 'output', 'parse', 'skip', 'because'}
# a link to a file: its path without the heading
LINK = re.compile(r'\]\((?!https?:|#)([^)#]+)')
BLOCK = re.compile(
    r'^<!-- snippet: python\n(?P<setup>.*?)^-->'
    r'|^(?:<!-- snippet: (?P<directive>[^\n]*) -->\n+)?^```(?P<language>\w*)\n(?P<text>.*?)^```',
    re.DOTALL | re.MULTILINE,
)


@dataclass(frozen=True)
class Snippet:
    """One block: its language, its text, where it stands, and what its directive says."""

    language: str
    text: str
    where: str
    directive: dict[str, str] = field(default_factory=dict)

    def commands(self) -> Iterator[list[str]]:
        """Yield the words of each command of a shell block, without variables set before it."""
        for line in self.text.replace('\\\n', ' ').splitlines():
            words: list[str] = []
            for word in [*shlex.split(line, comments=True), '&&']:
                if word != '&&':
                    words += [] if not words and re.match(r'[A-Z_]+=', word) else [word]
                elif words:
                    yield words
                    words = []


def snippets(page: Path) -> list[Snippet]:
    """Return the snippets of a page; AssertionError for a directive that is none."""
    text = page.read_text(encoding='utf-8')
    found = []
    for match in BLOCK.finditer(text):
        where = f'{page.name}:{text.count(chr(10), 0, match.start()) + 1}'
        if match['setup'] is not None:
            found.append(Snippet('python', match['setup'], where))
        else:
            directive = parsed(match['directive'] or '', where)
            found.append(Snippet(match['language'], match['text'], where, directive))
    fences = len(re.findall(r'^ *```', text, re.MULTILINE))
    blocks = sum(match['text'] is not None for match in BLOCK.finditer(text))
    assert fences == 2 * blocks, f'{page.name}: blocks must begin at the line, got {fences} fences'
    outside = BLOCK.sub('', text)
    loose = re.findall(r'^    (?:denoc|ros2|make|python3?|pip) .*', outside, re.MULTILINE)
    assert not loose, f'{page.name}: commands must stand in blocks, got {loose}'
    assert text.count('<!-- snippet:') == sum(bool(s.directive) for s in found) + len(
        re.findall(r'^<!-- snippet: python$', text, re.MULTILINE)
    ), f'{page.name}: a directive must stand right before a block'
    return found


def parsed(directive: str, where: str) -> dict[str, str]:
    """Return the keys and values of a directive."""
    values = {}
    for word in shlex.split(directive):
        key, _, value = word.partition('=')
        assert key in KEYS, f'{where}: a directive must be of {sorted(KEYS)}, got {key!r}'
        values[key] = value
    quiet = {'skip', 'parse'} & values.keys()
    assert not quiet or values.get('because'), f'{where}: {quiet} must say because="..."'
    return values


def shows(output: str, line: str) -> bool:
    """Say whether a line is in the output; numbers to 0.1 %, or to the last digit printed."""
    return any(alike(line, printed) for printed in output.splitlines())


def alike(line: str, printed: str) -> bool:
    """Say whether two lines are the same but for spaces and the numbers' last digits."""
    number = re.compile(r'(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?')
    shape = [' '.join(number.sub('#', text).split()) for text in (line, printed)]
    pairs = zip(number.findall(line), number.findall(printed), strict=False)
    return shape[0] == shape[1] and all(close(*pair) for pair in pairs)


def close(shown: str, printed: str) -> bool:
    """Say whether a number printed is the one shown: to 0.1 %, or to its last decimal."""
    decimals = len(shown.partition('.')[2].partition('e')[0])
    exponent = int(shown.partition('e')[2] or 0)
    last = 1.01 * 10.0 ** (exponent - decimals) if decimals else 0.0
    return abs(float(shown) - float(printed)) <= max(last, 1e-3 * abs(float(shown)))
