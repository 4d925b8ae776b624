"""README and docs: every snippet runs, in the order of its page, in a folder of the page's own."""

from __future__ import annotations

import io
import re
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import pytest
from pages import Snippet, shows, snippets
from snippet_kinds import check_xml, check_yaml, run_command

# What is written, packed or listed is the whole package.
pytestmark = pytest.mark.parts('all')

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / 'README.md', *sorted((ROOT / 'docs').glob('*.md'))]
LANGUAGES = {'python', 'sh', 'yaml', 'xml', 'text', 'mermaid', 'math', ''}
# pages whose snippets take more than five seconds
LONG = {'bases', 'control', 'fastest', 'films', 'identify', 'reports', 'scenarios'}
LONG |= {'tutorial_4_shaped_moveit', 'tutorial_7_fastest_cycle'}
OF_ROS = re.compile(r'^(denoc up |ros2 |denoc-)|ros__parameters|^nodes:', re.MULTILINE)


def page_parameters() -> list[Any]:
    """Return the pages; those whose snippets need nodes are marked so."""
    return [
        pytest.param(
            page,
            id=page.stem,
            marks=[pytest.mark.ros]
            * any(OF_ROS.search(snippet.text) for snippet in snippets(page))
            + [pytest.mark.long] * (page.stem in LONG),
        )
        for page in PAGES
    ]


@pytest.mark.parametrize('page', page_parameters())
def test_every_snippet_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ('config', 'docs', 'test', 'launch'):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {'__name__': 'page'}
    output = ''
    for snippet in snippets(page):
        if 'skip' not in snippet.directive:
            try:
                output = run(snippet, names, tmp_path, output)
            except Exception as error:
                raise AssertionError(f'{snippet.where} ({snippet.language}): {error}') from error


def run(snippet: Snippet, names: dict[str, Any], folder: Path, before: str) -> str:
    """Run one snippet; return what it printed, or what the one before did."""
    assert snippet.language in LANGUAGES, snippet.language
    if snippet.language == 'xml':
        check_xml(snippet, folder)
    elif snippet.language == 'yaml':
        check_yaml(snippet, folder)
    elif 'output' in snippet.directive:
        missing = [row for row in snippet.text.splitlines() if row and not shows(before, row)]
        assert not missing, f'not printed: {missing}; but\n{before}'
    elif snippet.language in ('python', 'sh'):
        with redirect_stdout(io.StringIO()) as printed:
            execute(snippet, names)
        return printed.getvalue()
    return before


def execute(snippet: Snippet, names: dict[str, Any]) -> None:
    """Run code in the page's names, or commands one after another."""
    if snippet.language == 'python':
        exec(compile(snippet.text, snippet.where, 'exec'), names)
        return
    for words in snippet.commands():
        run_command(words, snippet)


@pytest.mark.parametrize('page', PAGES, ids=[page.stem for page in PAGES])
def test_every_link_leads_somewhere(page: Path) -> None:
    text = page.read_text(encoding='utf-8')
    targets = re.findall(r'\]\((?!https?:|#)([^)#]+)', text) + re.findall(r'src="([^"]+)"', text)
    assert [target for target in targets if not (page.parent / target).exists()] == []


def test_every_tutorial_says_how_long_its_commands_take() -> None:
    tutorials = sorted((ROOT / 'docs').glob('tutorial_*.md'))
    assert len(tutorials) >= 7
    for page in tutorials:
        text = ' '.join(page.read_text('utf-8').split())
        assert re.search(r'commands take \d+ s of processor time', text), page.name


def test_every_page_is_linked_from_the_index() -> None:
    index = ROOT / 'docs' / 'index.md'
    linked = re.findall(r'\]\(([^)#]+\.md)', index.read_text(encoding='utf-8'))
    assert {page.name for page in PAGES[1:] if page != index} <= set(linked)


@pytest.mark.parametrize(
    ('line', 'shown'),
    [
        ('zeta 0.0120', True),  # as printed, or the last digit off
        ('zeta   0.0119', True),
        ('zeta 0.0130', False),
        ('omega 0.0120', False),
        ('2 modes, 1.2e-3 m', True),
        ('3 modes, 1.2e-3 m', False),
    ],
)
def test_an_output_that_is_not_printed_is_found_out(line: str, shown: bool) -> None:
    assert shows('zeta 0.0120\n  2 modes, 1.195e-03 m', line) == shown


WRONG = {
    'a name that is not there': '```python\nprint(undefined)\n```',
    'an option that is not there': '```sh\ndenoc check config/robots/puma.urdf --option\n```',
    'a file that is not there': '```sh\ndenoc check robot.urdf\n```',
    'a target that is not there': '```sh\nmake coffee\n```',
    'an argument of no launch file': '```sh\nros2 launch denoc_ros sim.launch.py arm:=1\n```',
    'a campaign without the option': '```sh\npython -m campaigns rates --hours 2\n```',
    'a campaign that is not there': '```sh\npython -m campaigns coffee\n```',
    'an extra that is not there': "```sh\npip install '.[coffee]'\n```",
    'a key of no scenario': '```yaml\ntorque: {kind: zero}\nlength: 5\n```',
    'a robot that is not there': '```yaml\nrobot: robots/arm.urdf\n```',
    'an attribute of no beam': '```xml\n<beam link="a" length="1" colour="red"/>\n```',
    'an output that is not printed': '<!-- snippet: output -->\n```text\nall well\n```',
    'a directive that is none': '<!-- snippet: maybe -->\n```sh\nmake test\n```',
    'a skip without a reason': '<!-- snippet: skip -->\n```sh\nmake test\n```',
    'a directive far from its block': '<!-- snippet: output -->\n\nWords.\n```text\na\n```',
    'another language': '```bash\ntrue\n```',
    'a command in no block': '    denoc check config/robots/puma.urdf',
    'a block that is indented': '- ```sh\n  true\n  ```',
}


@pytest.mark.parametrize('block', WRONG.values(), ids=list(WRONG))
def test_a_wrong_snippet_is_found_out(
    block: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = tmp_path / 'page.md'
    page.write_text(f'# Page\n\n{block}\n')
    with pytest.raises(AssertionError):
        test_every_snippet_runs(page, tmp_path, monkeypatch)


@pytest.mark.ros
@pytest.mark.parametrize(
    'block',
    [
        '```sh\nros2 param set /feedforward terms.weight false\n```',
        '```sh\nros2 param set /feedforward ramp_time -1.0\n```',
        '```sh\nros2 service call /predictor/brew std_srvs/srv/Trigger\n```',
        '```sh\nros2 run denoc_ros denoc brew\n```',
        "```sh\nros2 topic pub --once /a std_msgs/msg/String '{text: hello}'\n```",
        '```yaml\nfeedforward:\n  ros__parameters: {model: wobbly}\n```',
        '```yaml\nrobot: robots/puma.urdf\nnodes: {plant: {colour: red}}\n```',
    ],
)
def test_a_wrong_parameter_is_found_out(
    block: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    test_a_wrong_snippet_is_found_out(block, tmp_path, monkeypatch)
