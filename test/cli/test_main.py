"""The frame of the command line: status, messages, and a start that costs nothing."""

from __future__ import annotations

import argparse
import subprocess
import sys
import types
from collections.abc import Callable
from pathlib import Path

import pytest

from denoc_ros.cli import main as frame
from denoc_ros.cli.verbs import CAMPAIGNS, verbs
from denoc_ros.errors import ConfigError, StateError


def fake_verb(run: Callable[[argparse.Namespace], int]) -> types.ModuleType:
    module = types.ModuleType('fake')
    module.__dict__['run'] = run
    module.__dict__['DESCRIPTION'] = ''
    module.__dict__['add_options'] = lambda _parser: None
    return module


def raising(error: BaseException) -> Callable[[argparse.Namespace], int]:
    def run(_args: argparse.Namespace) -> int:
        raise error

    return run


@pytest.mark.parametrize(
    ('error', 'status', 'message'),
    [
        (StateError('q must be finite'), 1, 'denoc check: q must be finite\n'),
        (ConfigError('a.yaml', ['x', 'y']), 1, 'denoc check: a.yaml: x\ndenoc check: a.yaml: y\n'),
        (FileNotFoundError(2, 'No such file', 'a.urdf'), 1, 'denoc check: a.urdf: No such file\n'),
        (KeyboardInterrupt(), 130, 'denoc check: interrupted\n'),
        (
            SystemError('error return without exception set'),  # of a library out of memory
            1,
            'denoc check: memory must be enough for what was asked, got: error return without '
            'exception set\n',
        ),
    ],
)
def test_errors_become_a_message_and_a_status(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    status: int,
    message: str,
) -> None:
    monkeypatch.setitem(sys.modules, 'denoc_ros.cli.check_verb', fake_verb(raising(error)))
    assert frame.main(['check']) == status
    assert capsys.readouterr().err == message


@pytest.mark.long_cases('up')
@pytest.mark.parametrize('verb', ['check', 'up'])
def test_an_interrupt_in_code_from_a_string_is_one_like_any(tmp_path: Path, verb: str) -> None:
    """`python -m` itself ends by SIGINT once a plain KeyboardInterrupt came out of such code."""
    (tmp_path / 'interrupted.py').write_text(
        'import importlib, signal, sys\n'
        'from denoc_ros.cli import main as frame\n'
        f'verb = importlib.import_module("denoc_ros.cli.{verb}_verb")\n'
        'verb.__dict__["_configured" if hasattr(verb, "_configured") else "run"] = (\n'
        '    lambda args: eval("signal.raise_signal(signal.SIGINT)"))\n'
        'sys.exit(frame.main())\n'
    )
    command = [sys.executable, '-m', 'interrupted', verb, 'robot']
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert (run.returncode, run.stderr) == (130, f'denoc {verb}: interrupted\n')


def test_an_interrupt_that_an_import_swallows_ends_the_command(tmp_path: Path) -> None:
    (tmp_path / 'swallowing.py').write_text(
        'import importlib, signal, sys\n'
        'from denoc_ros.cli import main as frame\n'
        'importing = importlib.import_module\n'
        'def swallow(name):\n'
        '    try:\n'
        '        signal.raise_signal(signal.SIGINT)\n'
        '    except BaseException:\n'
        '        pass\n'
        '    return importing(name)\n'
        'importlib.import_module = swallow\n'
        'sys.exit(frame.main())\n'
    )
    command = [sys.executable, '-m', 'swallowing', 'check', 'robot']
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert (run.returncode, run.stderr) == (130, 'denoc check: interrupted\n')


def test_status_of_a_verb_is_the_exit_status(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'denoc_ros.cli.check_verb', fake_verb(lambda _args: 2))
    assert frame.main(['check']) == 2


def test_bad_usage_is_bad_input(capsys: pytest.CaptureFixture[str]) -> None:
    assert frame.main(['replay']) == 1
    assert 'the following arguments are required' in capsys.readouterr().err
    assert frame.main(['nothing']) == 1


@pytest.mark.parametrize('words', CAMPAIGNS)
def test_command_that_is_a_campaign_says_so(
    words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert frame.main([*words.split(), '--json']) == 1
    name = CAMPAIGNS[words]
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith(f'{words} is a campaign: run python -m campaigns {name} in a checkout')


def test_help_lists_every_verb(capsys: pytest.CaptureFixture[str]) -> None:
    assert frame.main(['--help']) == 0
    text = capsys.readouterr().out
    assert all(f'\n    {verb}' in text for verb in verbs())


def test_help_imports_nothing_heavy() -> None:
    code = (
        'import sys; from denoc_ros.cli.main import main; main(["--help"]); '
        'print([m for m in ("numpy", "numba", "rclpy", "matplotlib") if m in sys.modules])'
    )
    run = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, timeout=60)
    assert run.stdout.splitlines()[-1] == '[]'


def test_closed_pipe_is_quiet() -> None:
    command = f'{sys.executable} -m denoc_ros.cli.main --help | head -0; exit ${{PIPESTATUS[0]}}'
    run = subprocess.run(['bash', '-c', command], capture_output=True, text=True, timeout=60)
    assert 'Traceback' not in run.stderr


@pytest.mark.long_cases('up-config/tip.yaml-rclpy')
@pytest.mark.parametrize(
    ('verb', 'robot', 'lacks'),
    [
        ('up', 'config/tip.yaml', 'rclpy'),
        pytest.param(
            'view', 'config/robots/canadarm.urdf', 'viser', marks=pytest.mark.parts('viewer')
        ),
    ],
)
def test_a_verb_whose_extra_is_missing_says_which(
    repository: Path, verb: str, robot: str, lacks: str
) -> None:
    code = (
        f'import sys; sys.modules[{lacks!r}] = None; from denoc_ros.cli.main import main; '
        f'sys.exit(main([{verb!r}, {robot!r}]))'
    )
    run = subprocess.run(
        [sys.executable, '-c', code], cwd=repository, capture_output=True, text=True, timeout=120
    )
    assert run.returncode == 1
    assert run.stderr.startswith(f'denoc {verb}: {lacks} must be importable, got')
