"""Files that commands write: whole, or not there; an earlier one stays as it was."""

from __future__ import annotations

import os
import resource
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from denoc_ros.bags.writer import BagWriter
from denoc_ros.cli.main import main
from denoc_ros.errors import BagError, ConfigError, DenocError
from denoc_ros.output_files import require_new, whole_file, write_new, write_text
from denoc_ros.parts import PARTS

ROBOT = 'config/robots/single_link.urdf'
SCENARIO = 'config/scenarios/single_link.yaml'
MOTION = 'kind: points\njoints: [joint_1]\ntimes: [0, 1]\npositions: [[0], [0.1]]\n'


@contextmanager
def full_disk(size: int = 4096) -> Iterator[None]:
    """Let no file grow beyond a size [bytes]: the system refuses the rest, as a full disk does."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_refused_write_leaves_nothing_and_names_the_file(tmp_path: Path) -> None:
    with full_disk(), pytest.raises(ConfigError, match=r'^\S+/a\.txt: the file must be writable'):
        write_text(tmp_path / 'a.txt', 'x' * 10_000)
    assert not list(tmp_path.iterdir())


def test_an_earlier_file_stays_as_it_was_until_the_new_one_is_whole(tmp_path: Path) -> None:
    file = tmp_path / 'a.txt'
    file.write_text('before')
    with full_disk(), pytest.raises(ConfigError):
        write_text(file, 'x' * 10_000)
    with suppress(KeyboardInterrupt), whole_file(file) as unfinished:
        unfinished.write_text('half')
        raise KeyboardInterrupt
    assert file.read_text() == 'before'
    write_text(file, 'after')
    assert file.read_text() == 'after'
    assert list(tmp_path.iterdir()) == [file]


def test_new_files_never_replace(tmp_path: Path) -> None:
    file = tmp_path / 'a.txt'
    write_new(file, 'one')
    with pytest.raises(BagError, match='must not exist yet'):
        write_new(file, 'two')
    with pytest.raises(BagError, match='must not exist yet'):
        require_new(None, file)
    with pytest.raises(ConfigError, match='No such file or directory'):
        write_text(tmp_path / 'none' / 'a.txt', '')


def test_links_pipes_and_folders_are_what_they_were(tmp_path: Path) -> None:
    target, link, pipe = tmp_path / 'a.txt', tmp_path / 'link', tmp_path / 'pipe'
    link.symlink_to(target)
    write_text(link, 'through')
    assert link.is_symlink()
    assert target.read_text() == 'through'
    os.mkfifo(pipe)
    got: list[str] = []
    reader = threading.Thread(target=lambda: got.append(pipe.read_text()), daemon=True)
    reader.start()
    write_text(pipe, 'down')
    reader.join(10.0)
    assert got == ['down']
    with whole_file(tmp_path / 'bag') as unfinished, BagWriter(unfinished) as bag:
        bag.add_topic('/a', 'std_msgs/msg/String')
    assert {path.name for path in (tmp_path / 'bag').iterdir()} == {'bag_0.mcap', 'metadata.yaml'}


def test_errors_name_the_file_and_not_the_one_beside_it(tmp_path: Path) -> None:
    with pytest.raises(DenocError) as told, whole_file(tmp_path / 'a.mp4') as unfinished:
        raise DenocError(f'{unfinished}: the film must be encoded')
    assert str(told.value) == f'{tmp_path}/a.mp4: the film must be encoded'


def commands(folder: Path) -> dict[str, list[str]]:
    """Return command lines that write more than a small disk holds, by the output's name."""
    run = folder / 'run.mcap'
    simulated = ['simulate', ROBOT, SCENARIO, '-o']
    assert main([*simulated, str(run)]) == 0
    motion = folder / 'motion.yaml'
    motion.write_text(MOTION)
    return {
        'plan.yaml': ['shape', ROBOT, str(motion), '--method', 'zv', '-o'],
        'report.html': ['report', str(run), '-o'],
        'other.mcap': simulated,
        'bag': simulated,
        'replay.mcap': ['replay', str(run), '--robot', ROBOT, '-o'],
        'robot.urdf': ['dh', 'config/dh/planar_3dof.yaml', '-o'],
        'page.html': ['check', ROBOT, '--bode', 'joint_1:joint_1', '-o'],
        'strip.png': ['view', str(run), '--strip'],
    }


@pytest.mark.parts(*PARTS)
def test_a_full_disk_leaves_no_stub_of_any_command(
    tmp_path: Path,
    repository: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A stub of 4096 bytes was left, and its name then refused as existing."""
    monkeypatch.chdir(repository)
    made = commands(tmp_path)
    capsys.readouterr()
    before = {path.name for path in tmp_path.iterdir()}
    for name, command in made.items():
        with full_disk():
            status = main([*command, str(tmp_path / name)])
        said = capsys.readouterr().err
        assert status == 1, name
        assert 'Traceback' not in said
        assert name in said
        assert {path.name for path in tmp_path.iterdir()} == before, name
