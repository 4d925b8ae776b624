"""Names of outputs: a dot is no suffix, and no page takes the place of another unasked."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from denoc_ros.cli.arguments import unused
from denoc_ros.cli.main import main
from denoc_ros.cli.replay_verb import _default_output
from denoc_ros.reports.report_verb import default_output
from denoc_ros.simulation.recorded.run_files import recording_name


def test_recordings_with_dots_in_their_names_have_names_of_their_own() -> None:
    names = ('OCP_T2_0.55s', 'OCP_T2_0.46s', 'OCP_T2_0.46s.mcap')
    assert [recording_name(Path(name)) for name in names] == [names[0], names[1], names[1]]
    outputs = {_default_output(Path(name), Path(name)).name for name in names[:2]}
    assert outputs == {'OCP_T2_0.55s_replay', 'OCP_T2_0.46s_replay'}


def test_page_takes_a_free_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert default_output(Path('run_0.5s')) == Path('run_0.5s.html')
    Path('run_0.5s.html').touch()
    assert default_output(Path('run_0.5s')) == Path('run_0.5s_2.html')
    Path('run_0.5s_2.html').touch()
    assert unused(Path('run_0.5s.html')) == Path('run_0.5s_3.html')


@pytest.mark.parts('identification')
def test_result_that_is_replaced_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    noise = np.random.default_rng(1).standard_normal(60)
    table = tmp_path / 'noise.csv'
    np.savetxt(table, noise)
    command = ['identify', str(table), '--rate', '50', '-o', str(tmp_path / 'result_0.5')]
    main(command)
    assert 'replaced' not in capsys.readouterr().err
    main(command)
    assert 'result_0.5: the earlier result is replaced' in capsys.readouterr().err
