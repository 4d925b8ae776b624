"""`python -m campaigns`: the list, and one that runs with its paths."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest
from campaign_table import CAMPAIGNS, environment


def campaigns(repository: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, '-m', 'campaigns', *arguments]
    return subprocess.run(command, cwd=repository, capture_output=True, text=True, timeout=120)


def test_list_has_every_campaign(repository: Path) -> None:
    shown = campaigns(repository).stdout
    assert [row.partition(' ')[0] for row in shown.splitlines()[2:]] == list(CAMPAIGNS)


def test_campaign_runs_with_its_options(repository: Path) -> None:
    ran = campaigns(repository, 'counts', '--json')
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.startswith('{')


def test_unknown_name_is_refused(repository: Path) -> None:
    ran = campaigns(repository, 'coffee')
    assert (ran.returncode, ran.stdout) == (1, '')
    assert ran.stderr.endswith('got coffee\n')


@pytest.mark.parametrize('name', CAMPAIGNS)
def test_module_exists(name: str) -> None:
    module = CAMPAIGNS[name].command.split()[0]
    assert importlib.util.find_spec(module) is not None


def test_paths_of_the_caller_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('PYTHONPATH', '/own')
    found = environment(CAMPAIGNS['bounds'])
    assert found['PYTHONPATH'].endswith(':/own')
    assert found['DENOC_CHECK_BOUNDS'] == '1'
