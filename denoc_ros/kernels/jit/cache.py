"""The cache of compiled kernels: its folder, and its files with their checksums.

Nobody else can write to the folder: the compiled code in it is run.
"""

from __future__ import annotations

import hashlib
import logging
import os
import pickle
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
from llvmlite.binding import get_host_cpu_name
from numba.core import caching
from numba.core.compiler import CompileResult
from numba.core.runtime import rtsys
from numba.core.serialize import dumps

from denoc_ros.kernels import CHECKED

OTHERS = stat.S_IWGRP | stat.S_IWOTH


class NotPrivateError(PermissionError):
    """Somebody else can write where only this user may."""


def private_folder(path: Path) -> Path:
    """Make a folder, and the missing ones above it, in which only this user can write.

    Every folder on the way must belong to this user or to the system, and must not be writable by
    others. A folder above it may be if it is sticky, as the temporary one is: nobody can replace
    there what belongs to somebody else.

    Parameters
    ----------
    path : Path
        The folder; links on the way must belong to this user or to the system.

    Returns
    -------
    Path
        The folder without links.

    Raises
    ------
    NotPrivateError
        If somebody else can write there, with the reason.
    OSError
        If it cannot be made.
    """
    given = Path(os.path.abspath(path))
    missing = []
    existing = given
    while not os.path.lexists(existing):
        missing.append(existing)
        existing = existing.parent
    if missing:
        _check_parents(missing[-1])
    for each in reversed(missing):
        with suppress(FileExistsError):  # by another process of ours, or refused below
            # makedirs gives the mode to the last one only, and the others what the umask leaves
            os.mkdir(each, 0o700)
    _check_parents(given)
    real = given.resolve(strict=True)
    about = real.stat()
    if not stat.S_ISDIR(about.st_mode):
        raise NotADirectoryError(f'{real} is not a folder')
    if about.st_uid != os.geteuid() or is_writable_by_others(about):
        raise NotPrivateError(_objection(real, about))
    return real


def is_writable_by_others(about: os.stat_result) -> bool:
    """Say whether more than the owner can write; a group of the user alone counts as the user."""
    writable = about.st_mode & OTHERS
    if writable == stat.S_IWGRP and _is_group_of_one(about.st_gid, about.st_uid):
        return False
    return bool(writable)


def _check_parents(path: Path) -> None:
    """Raise NotPrivateError unless the folders above a path are safe, and those behind links."""
    for way in (path, path.parent.resolve() / path.name):
        shared = False  # with others who can make files there
        for each in (*reversed(way.parents), way):
            if not os.path.lexists(each):
                return
            about = each.lstat()
            # in a container the system's files may belong to the number of an unknown user
            owners = {0, os.geteuid()} if shared else {0, os.geteuid(), os.stat('/').st_uid}
            if about.st_uid not in owners:
                raise NotPrivateError(_objection(each, about))
            shared = stat.S_ISDIR(about.st_mode) and is_writable_by_others(about)
            if shared and each != way and not about.st_mode & stat.S_ISVTX:
                raise NotPrivateError(_objection(each, about))


def _objection(folder: Path, about: os.stat_result) -> str:
    mode = stat.S_IMODE(about.st_mode)
    return (
        f'{folder} must belong to user {os.geteuid()}, writable by nobody else, '
        f'got owner {about.st_uid}, mode {mode:04o}'
    )


def _is_group_of_one(group: int, user: int) -> bool:
    """Say whether a group is the one that many systems make for each user, without others."""
    import grp
    import pwd

    try:
        name, entry = pwd.getpwuid(user).pw_name, grp.getgrgid(group)
    except KeyError:
        return False
    return entry.gr_name == name and set(entry.gr_mem) <= {name}


LOG = logging.getLogger('denoc_ros')
PACKAGE = Path(__file__).resolve().parents[2]
# what these say changes no compiled code
WITHOUT_KERNELS = ('__init__.py', 'cache.py', 'compiling.py')
SUFFIX = '.kernel'  # of a file: a checksum and machine code as numba serializes it
CHECKSUM = hashlib.sha256


@cache
def cache_folder() -> Path | None:
    """Return the folder that holds the compiled kernels of this very source, None for no cache.

    It is the first of `NUMBA_CACHE_DIR`, the user's cache and the temporary folder in which nobody
    else can write. If somebody else holds all of them, it is one in the temporary folder under a
    name of its own, which later processes find again.
    """
    objections = []
    for folder in _candidates():
        try:
            folder = private_folder(folder)
            with tempfile.TemporaryFile(dir=folder):
                pass
        except NotPrivateError as error:
            objections.append(str(error))
            continue
        except OSError:  # a home that does not exist, a disk that is full
            continue
        if objections:
            LOG.warning('compiled kernels go to %s: %s', folder, objections[0])
        return folder
    why = f': {objections[0]}' if objections else ''
    LOG.warning('compiled kernels are not kept, each start compiles them again%s', why)
    return None


def _candidates() -> Iterator[Path]:
    """Yield folders that may hold the kernels, the preferred one first."""
    name = f'{"checked" if CHECKED else "kernels"}-{_digest()}'
    named = os.environ.get('NUMBA_CACHE_DIR')
    if named:
        yield Path(named) / name
    with suppress(RuntimeError):  # a user without a home
        yield Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache', 'denoc_ros', name)
    temporary = Path(tempfile.gettempdir())
    user = f'denoc_ros-{os.geteuid()}'
    yield temporary / user / name
    for own in sorted(temporary.glob(f'{user}-*')):
        yield own / name
    with suppress(OSError):
        fresh = Path(tempfile.mkdtemp(prefix=f'{user}-'))
        yield fresh / name
        fresh.rmdir()  # refused, as all the others


def _digest() -> str:
    """Return a digest of the kernels' source, of compiler, interpreter and processor."""
    key = numba.__version__, sys.implementation.cache_tag, get_host_cpu_name()
    digest = hashlib.sha256(repr(key).encode())
    for path in sorted(PACKAGE.glob('**/kernels/**/*.py')):
        if path.name not in WITHOUT_KERNELS:
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


class KernelCache(caching.Cache):  # type: ignore[misc]
    """Keeps the machine code of one function: a file for each of its signatures.

    Numba itself has an index beside them, keeps both by the path and age of the source, so that
    each installation compiles again, and runs whatever bytes a damaged file has.

    Parameters
    ----------
    function : function
        The Python function that is compiled.
    folder : Path
        A folder in which nobody else can write; its name tells the source.
    """

    def __init__(self, function: Callable[..., Any], folder: Path) -> None:
        self._py_func = function
        self._folder = folder
        self._name = _file_name(function)
        self.enable()

    @property
    def cache_path(self) -> str:
        """The folder."""
        return str(self._folder)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load compiled code, None if there is none or a damaged one."""
        if not self._enabled:
            return None
        content = _read(self._file(sig, target_context.codegen()))
        if content is None:
            return None
        # numba loads all its types and functions first, 0.2 s, which only compiling needs
        rtsys.initialize(target_context)
        return CompileResult._rebuild(target_context, *pickle.loads(content))

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep compiled code; a folder that is full or gone costs time, at the next start."""
        if not self._enabled or data.library.has_dynamic_globals:
            return
        try:
            private_folder(self._folder)
            _write(self._file(sig, data.codegen), dumps(data._reduce()))
        except OSError as error:
            _say_not_kept(str(error))

    def flush(self) -> None:
        """Remove all kept code."""
        for file in self._folder.glob(f'{self._name}.*{SUFFIX}'):
            file.unlink(missing_ok=True)

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        """Return the key of a signature; the folder's name tells the source."""
        return sig, codegen.magic_tuple()

    def _file(self, sig: Any, codegen: Any) -> Path:
        """Return the file for a signature and a processor."""
        key = CHECKSUM(repr(self._index_key(sig, codegen)).encode()).hexdigest()[:16]
        return self._folder / f'{self._name}.{key}{SUFFIX}'


def keep(dispatcher: Any) -> Any:
    """Give a function of this package its place in the cache, if there is one; return it."""
    folder = cache_folder()
    function = dispatcher.py_func
    if folder is not None and _is_here(function.__code__.co_filename):
        dispatcher._cache = KernelCache(function, folder)
    return dispatcher


@cache
def _is_here(source: str) -> bool:
    file = Path(source).resolve()
    return file.is_relative_to(PACKAGE) and 'kernels' in file.relative_to(PACKAGE).parts


def is_kept(dispatcher: Any) -> bool:
    """Say whether a kernel has been compiled before, by this version on this machine."""
    folder = cache_folder()
    if folder is None:
        return False
    files = folder.glob(f'{_file_name(dispatcher.py_func)}.*{SUFFIX}')
    return any(_read(file) is not None for file in files)


def _file_name(function: Any) -> str:
    """Return how the names of a function's files begin."""
    module = function.__module__.rpartition('.')[2]
    name = function.__qualname__.replace('<', '').replace('>', '')
    return f'{module}.{name}-{function.__code__.co_firstlineno}'


def _read(file: Path) -> bytes | None:
    """Return the content of a file after its checksum, None unless it is ours and whole."""
    try:
        with file.open('rb') as opened:
            about = os.fstat(opened.fileno())
            content = opened.read()
    except OSError:
        return None
    if about.st_uid != os.geteuid() or is_writable_by_others(about):
        return None
    size = CHECKSUM().digest_size
    return content[size:] if content[:size] == _checksum(file, content[size:]) else None


def _write(file: Path, content: bytes) -> None:
    """Write a file in one go: who reads it meanwhile finds the old one, or none."""
    handle, temporary = tempfile.mkstemp(dir=file.parent, prefix=file.name)
    try:
        with os.fdopen(handle, 'wb') as opened:
            opened.write(_checksum(file, content) + content)
        os.replace(temporary, file)
    except BaseException:
        with suppress(OSError):
            os.unlink(temporary)
        raise


def _checksum(file: Path, content: bytes) -> bytes:
    """Return the checksum of a file's name and content: one with another's name is not whole."""
    return CHECKSUM(file.name.encode() + b'\0' + content).digest()


@cache
def _say_not_kept(why: str) -> None:
    LOG.warning('a compiled kernel is not kept: %s', why)
