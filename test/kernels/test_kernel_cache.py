"""Compiled kernels come from folders and files that nobody else can have written."""

from __future__ import annotations

import errno
import logging
import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NoReturn

import numba
import pytest

from denoc_ros.kernels.jit import cache
from denoc_ros.kernels.jit.cache import KernelCache, NotPrivateError, cache_folder, private_folder

STRANGER = 54321
as_root = pytest.mark.skipif(os.geteuid() != 0, reason='only root can give files away')


@pytest.fixture(autouse=True)
def cleared() -> Iterator[None]:
    """Have the folder be looked for anew, also by later tests."""
    cache_folder.cache_clear()
    yield
    cache_folder.cache_clear()


@pytest.fixture
def places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Path]:
    """Return the three places of a cache: named, the home's and the temporary folder."""
    found = {name: tmp_path / name for name in ('named', 'home', 'temporary')}
    found['temporary'].mkdir()
    found['temporary'].chmod(0o1777)
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(found['named']))
    monkeypatch.setenv('XDG_CACHE_HOME', str(found['home']))
    monkeypatch.setattr('tempfile.tempdir', str(found['temporary']))
    return found


def used(places: dict[str, Path]) -> str:
    """Return which place the cache is in, '' for none."""
    folder = cache_folder()
    if folder is None:
        return ''
    assert folder.stat().st_mode & 0o777 == 0o700
    (place,) = [name for name, path in places.items() if folder.is_relative_to(path)]
    return place


def spoil(path: Path, way: str) -> None:
    """Let others write in a folder, in one of several ways."""
    if way == 'link':
        (path.parent / 'elsewhere').mkdir()
        path.symlink_to(path.parent / 'elsewhere')
        os.lchown(path, STRANGER, STRANGER)
        return
    path.mkdir(parents=True)
    if way == 'owner':
        os.chown(path, STRANGER, STRANGER)
    else:
        path.chmod(int(way, 8))


ways = pytest.mark.parametrize(
    'way',
    ['0777', '0702', pytest.param('owner', marks=as_root), pytest.param('link', marks=as_root)],
)


@ways
def test_a_folder_that_others_can_write_in_is_not_used(
    places: dict[str, Path], way: str, caplog: pytest.LogCaptureFixture
) -> None:
    spoil(places['named'], way)
    with caplog.at_level(logging.WARNING, 'denoc_ros'):
        assert used(places) == 'home'
        assert used(places) == 'home'
    assert len(caplog.records) == 1
    assert f'{places["named"]} must belong to user {os.geteuid()}' in caplog.text


@ways
def test_a_folder_above_that_others_can_write_in_is_not_trusted(
    places: dict[str, Path], monkeypatch: pytest.MonkeyPatch, way: str
) -> None:
    spoil(places['named'], way)
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(places['named'] / 'deep' / 'below'))
    assert used(places) == 'home'
    assert not (places['named'] / 'deep').exists()


@ways
def test_a_temporary_folder_that_another_user_made_is_passed_by(
    places: dict[str, Path], monkeypatch: pytest.MonkeyPatch, way: str
) -> None:
    monkeypatch.delenv('NUMBA_CACHE_DIR')
    monkeypatch.setenv('XDG_CACHE_HOME', '/dev/null/cache')  # cannot be made
    taken = places['temporary'] / f'denoc_ros-{os.geteuid()}'
    spoil(taken, way)
    folder = cache_folder()
    assert used(places) == 'temporary'
    assert folder is not None
    assert not folder.is_relative_to(taken)
    assert not folder.is_relative_to(places['temporary'] / 'elsewhere')
    cache_folder.cache_clear()
    assert cache_folder() == folder  # the next process finds it again


def test_there_is_no_cache_where_others_can_replace_folders(
    places: dict[str, Path], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.delenv('NUMBA_CACHE_DIR')
    monkeypatch.setenv('XDG_CACHE_HOME', '/dev/null/cache')
    places['temporary'].chmod(0o777)  # not sticky
    with caplog.at_level(logging.WARNING, 'denoc_ros'):
        assert used(places) == ''
    assert 'each start compiles them again' in caplog.text
    assert not list(places['temporary'].iterdir())


def test_a_mask_that_allows_all_makes_no_folder_that_others_can_write_in(
    places: dict[str, Path],
) -> None:
    before = os.umask(0)
    try:
        made = private_folder(places['home'] / 'one' / 'two')
    finally:
        os.umask(before)
    assert made == places['home'] / 'one' / 'two'
    assert [each.stat().st_mode & 0o777 for each in (made, *made.parents[:2])] == [0o700] * 3


def test_a_link_of_ours_may_lead_to_the_cache(places: dict[str, Path], tmp_path: Path) -> None:
    (tmp_path / 'large disk').mkdir(mode=0o755)
    places['named'].symlink_to(tmp_path / 'large disk')
    made = private_folder(places['named'] / 'one')
    assert made == tmp_path / 'large disk' / 'one'


def test_a_file_is_not_a_folder(tmp_path: Path) -> None:
    (tmp_path / 'file').touch(mode=0o600)
    with pytest.raises(NotADirectoryError, match='is not a folder'):
        private_folder(tmp_path / 'file')


@pytest.mark.parametrize('members', [['somebody'], []])
def test_a_group_of_the_user_alone_is_the_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, members: list[str]
) -> None:
    import grp
    import pwd

    name = pwd.getpwuid(os.geteuid()).pw_name
    entry = grp.struct_group((name, 'x', tmp_path.stat().st_gid, members))
    monkeypatch.setattr(grp, 'getgrgid', lambda _: entry)
    (tmp_path / 'made').mkdir()
    (tmp_path / 'made').chmod(0o775)
    if members:
        with pytest.raises(NotPrivateError, match='mode 0775'):
            private_folder(tmp_path / 'made')
    else:
        assert private_folder(tmp_path / 'made') == tmp_path / 'made'


def test_a_user_without_a_home_has_a_cache(
    places: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def nobody() -> NoReturn:
        raise RuntimeError('Could not determine home directory.')

    monkeypatch.delenv('NUMBA_CACHE_DIR')
    monkeypatch.delenv('XDG_CACHE_HOME')
    monkeypatch.setattr(Path, 'home', nobody)
    assert used(places) == 'temporary'


def function(x: Any) -> Any:
    return 3.0 * x + 1.0


def compiled(folder: Path) -> Any:
    """Compile the function, or load it, and see that it is right."""
    dispatcher = numba.njit(function)
    dispatcher._cache = KernelCache(function, folder)
    dispatcher.compile('float64(float64)')
    assert dispatcher(2.0) == 7.0
    return dispatcher


def is_loaded(dispatcher: Any) -> bool:
    return bool(sum(dispatcher._cache_hits.values()) == 1)


def flip(content: bytes, share: float) -> bytes:
    at = int(share * (len(content) - 1))
    return content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :]


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    'empty': lambda _: b'',
    'truncated': lambda content: content[: len(content) // 2],
    'one byte short': lambda content: content[:-1],
    'checksum alone': lambda content: content[:32],
    'garbage': lambda content: bytes(range(256)) * (len(content) // 256),
    'zeros': lambda content: bytes(len(content)),
    'longer': lambda content: content + b'\0',
    'doubled': lambda content: content + content,
} | {
    f'bit at {share:.0%}': lambda content, share=share: flip(content, share)  # type: ignore[misc]
    for share in (0.0, 0.01, 0.2, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
}


@pytest.mark.parametrize('damage', DAMAGES)
def test_a_damaged_file_is_compiled_anew(tmp_path: Path, damage: str) -> None:
    folder = private_folder(tmp_path / 'kernels')
    assert not is_loaded(compiled(folder))
    assert is_loaded(compiled(folder))
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    file.write_bytes(DAMAGES[damage](whole))
    assert not is_loaded(compiled(folder))
    assert [file] == list(folder.iterdir())
    assert is_loaded(compiled(folder))  # healed


def test_the_file_of_another_function_is_not_run(tmp_path: Path) -> None:
    folder = private_folder(tmp_path / 'kernels')
    compiled(folder)
    (file,) = folder.iterdir()
    other = numba.njit(function)
    other._cache = KernelCache(function, folder)
    other.compile('float64(int64)')
    (theirs,) = set(folder.iterdir()) - {file}
    theirs.replace(file)
    assert not is_loaded(compiled(folder))


class Bomb:
    """Runs a command of whoever wrote it when it is loaded."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.mark),)


@pytest.mark.parametrize('way', ['0666', '0602', pytest.param('owner', marks=as_root)])
def test_a_file_that_others_can_write_is_not_run(tmp_path: Path, way: str) -> None:
    folder = private_folder(tmp_path / 'kernels')
    compiled(folder)
    (file,) = folder.iterdir()
    cache._write(file, pickle.dumps(Bomb(tmp_path / 'mark')))  # with its right checksum
    if way == 'owner':
        os.chown(file, STRANGER, STRANGER)
    else:
        file.chmod(int(way, 8))
    assert not is_loaded(compiled(folder))
    assert not (tmp_path / 'mark').exists()


@pytest.mark.parametrize('failure', [errno.ENOSPC, errno.EROFS, errno.EIO])
def test_what_cannot_be_kept_is_compiled_all_the_same(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    failure: int,
) -> None:
    def fail(*_: Any) -> NoReturn:
        raise OSError(failure, os.strerror(failure))

    cache._say_not_kept.cache_clear()
    folder = private_folder(tmp_path / 'kernels')
    monkeypatch.setattr(os, 'replace', fail)
    with caplog.at_level(logging.WARNING, 'denoc_ros'):
        compiled(folder)
        compiled(folder)
    assert [record.getMessage() for record in caplog.records] == [
        f'a compiled kernel is not kept: [Errno {failure}] {os.strerror(failure)}'
    ]
    assert not list(folder.iterdir())


def test_a_folder_that_was_deleted_is_made_again(tmp_path: Path) -> None:
    folder = private_folder(tmp_path / 'kernels')
    folder.rmdir()
    compiled(folder)
    assert is_loaded(compiled(folder))


WRITER = """
import sys
from pathlib import Path
from denoc_ros.kernels.jit.cache import _read, _write
file = Path(sys.argv[1])
content = sys.argv[2].encode() * 50_000
for _ in range(100):
    _write(file, content)
    read = _read(file)
    assert read is not None and len(read) == len(content) and len(set(read)) == 1
"""


def test_processes_that_write_beside_each_other_leave_whole_files(tmp_path: Path) -> None:
    folder = private_folder(tmp_path / 'kernels')
    file = folder / 'one.kernel'
    processes = [
        subprocess.Popen([sys.executable, '-c', WRITER, str(file), each]) for each in 'abc'
    ]
    assert [process.wait(120.0) for process in processes] == [0, 0, 0]
    assert list(folder.iterdir()) == [file]
    assert cache._read(file) is not None
