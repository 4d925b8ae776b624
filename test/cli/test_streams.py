"""stdout, stderr, memory and Ctrl-C of a process that runs a command: one line, no traceback."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from itertools import product
from pathlib import Path

import pytest
from child_processes import child, children

from denoc_ros.cli.main import LONGEST, main

ROBOT = 'config/robots/single_link.urdf'
SCENARIO = 'config/scenarios/single_link.yaml'
DENOC = [sys.executable, '-m', 'denoc_ros.cli.main']


def denoc(
    repository: Path, *arguments: str, shell: str = '{}'
) -> subprocess.CompletedProcess[str]:
    """Run a command by the shell, in a process of its own."""
    line = shell.format(' '.join([*DENOC, *arguments]))
    environment = {**os.environ, 'OPENBLAS_NUM_THREADS': '1', 'PYTHONIOENCODING': ''}
    environment.pop('PYTHONUNBUFFERED', None)  # what is written late is what fails late
    return subprocess.run(
        ['bash', '-c', line],
        cwd=repository, env=environment, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip


SHELLS = ['{} >&-', '{} >&- 2>&-', '{} | true', '{} > /dev/full']


@pytest.mark.long_cases(
    'command0-{} >&-',
    'command1-{} >&- 2>&-',
    'command2-{} | true',
    'command3-{} > /dev/full',
    'command8-{} > /dev/full',
)
@pytest.mark.parametrize(
    ('command', 'shell'),
    [
        *product([['check', ROBOT], ['--help']], SHELLS),
        (['check', '--help'], SHELLS[-1]),  # by the same parser as all help
    ],
)
def test_output_that_nobody_takes_makes_no_traceback(
    repository: Path, command: list[str], shell: str
) -> None:
    ended = denoc(repository, *command, shell=shell)
    assert 'Traceback' not in ended.stderr
    assert 'Exception ignored' not in ended.stderr
    is_full = shell.endswith('full') and '--help' not in command  # argparse swallows it
    assert ended.returncode == (1 if is_full else 0)
    assert not is_full or 'No space left on device' in ended.stderr


@pytest.mark.long
def test_a_terminal_without_the_character_gets_its_code(repository: Path, tmp_path: Path) -> None:
    text = (repository / ROBOT).read_text().replace('joint_1', 'joint_😀')
    robot = tmp_path / 'robot.urdf'
    robot.write_text(text)
    ended = denoc(
        repository, 'check', str(robot), shell='LC_ALL=C PYTHONUTF8=0 PYTHONCOERCECLOCALE=0 {}'
    )
    assert ended.returncode == 0, ended.stderr
    assert r'joint_\U0001f600' in ended.stdout


@pytest.mark.long
def test_a_limit_of_memory_is_one_line(repository: Path, tmp_path: Path) -> None:
    for limit in (300_000, 500_000, 700_000):  # KiB
        shell = f'ulimit -v {limit}; {{}}'
        ended = denoc(
            repository, 'simulate', ROBOT, SCENARIO, '-o', str(tmp_path / 'a'), shell=shell
        )
        assert 'Traceback' not in ended.stderr, limit
        if ended.returncode == 0:
            break
        assert ended.returncode == 1
        assert len(ended.stderr.splitlines()) <= 2  # OpenBLAS may say it, and end the process


@pytest.mark.long
def test_ctrl_c_while_modules_are_imported_ends_with_130(repository: Path) -> None:
    """Python's own start, before the command has begun, is not in its hands."""
    line = 'import sys; sys.argv[0] = "denoc"; import denoc_ros.cli.main as m; '
    line += 'print(flush=True); sys.exit(m.main())'
    for wait in (0.02, 0.1, 0.2, 0.3, 0.4):
        process = subprocess.Popen(
            [sys.executable, '-c', line, 'check', ROBOT],
            cwd=repository, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(wait)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
        assert 'Traceback' not in said
        assert process.returncode in (0, 130)


def test_ctrl_c_before_the_command_has_begun_ends_with_130() -> None:
    """While its first modules are imported, which took a traceback."""
    line = (
        'import os, signal, sys; sys.argv = ["/usr/bin/denoc"]\n'
        'import denoc_ros.cli\n'
        'os.kill(os.getpid(), signal.SIGINT)'
    )
    ended = subprocess.run([sys.executable, '-c', line], capture_output=True, text=True)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, '', 'denoc: interrupted\n')
    # who imports the package has a Ctrl-C of their own
    line = 'import signal, denoc_ros.cli\nassert signal.getsignal(2) is signal.default_int_handler'
    assert subprocess.run([sys.executable, '-c', line]).returncode == 0


@pytest.mark.parametrize('moment', ['starts', pytest.param('works', marks=pytest.mark.long)])
def test_ctrl_c_with_workers_leaves_no_process_and_no_traceback(
    repository: Path, tmp_path: Path, moment: str
) -> None:
    """Two of four moments of their start ended in tracebacks and status -2."""
    words = ['config/robots/clamped_beam.urdf', 'config/scenarios/clamped_beam.yaml']
    words += ['--vary', 'beam.link_1.y.ei=8:12', '--runs', '300', '--workers', '2', '-o']
    with child(
        [*DENOC, 'simulate', *words, str(tmp_path / 'rows')],
        cwd=repository, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True,
    ) as process:  # fmt: skip
        until = time.monotonic() + 120.0
        while not (
            any((tmp_path / 'rows').glob('*')) if moment == 'works' else children(process.pid)
        ):
            assert process.poll() is None
            assert time.monotonic() < until
            time.sleep(0.01)
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does
        _, said = process.communicate(timeout=120)
        assert 'Traceback' not in said
        assert process.returncode == 130, said
        # what tracks their shared memory ends by itself
        until = time.monotonic() + 60.0
        with pytest.raises(ProcessLookupError):  # noqa: PT012
            while time.monotonic() < until:
                os.killpg(process.pid, 0)
                time.sleep(0.05)


def test_an_error_without_words_and_one_with_too_many_are_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    import denoc_ros.cli.check_verb as verb
    from denoc_ros.errors import BagError

    for text, said in (
        ('', 'denoc check: an error without words\n'),
        ('a\n\n \nb', 'denoc check: a\ndenoc check: b\n'),
        ('x' * (LONGEST + 7), f'denoc check: {"x" * LONGEST}… (7 characters more)\n'),
    ):

        def fail(_: object, text: str = text) -> int:
            raise BagError(text)

        monkeypatch.setattr(verb, 'run', fail)
        assert main(['check', ROBOT]) == 1
        assert capsys.readouterr().err == said
