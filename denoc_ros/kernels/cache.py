"""The cache of compiled kernels: by their names, wherever the package is installed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core import caching

HERE = Path(__file__).resolve().parent


class KernelLocator(caching._CacheLocator):  # type: ignore[misc]
    """Tells numba to keep the kernels of this package in one folder, whatever their files' path.

    Numba itself keeps them by the path and the age of their source: each installation of the same
    version would compile them again. The folder's name has a digest of all of the source, so what
    is in it is never stale.
    """

    def __init__(self, line: int) -> None:
        self._line = line

    def get_cache_path(self) -> str:
        """Return the folder."""
        return str(numba.config.CACHE_DIR)

    def get_source_stamp(self) -> str:
        """Return the same for all: another source has another folder."""
        return ''

    def get_disambiguator(self) -> str:
        """Return what tells functions of the same name in one file apart."""
        return str(self._line)

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> KernelLocator | None:
        """Return the locator of a kernel of this package, None for other functions."""
        if Path(py_file).resolve().parent != HERE:
            return None
        locator = cls(py_func.__code__.co_firstlineno)
        try:
            locator.ensure_cache_path()
        except OSError:
            return None
        return locator


def keep_by_name() -> None:
    """Let numba ask the locator of this package first."""
    caching.CacheImpl._locator_classes.insert(0, KernelLocator)


def is_kept(dispatcher: Any) -> bool:
    """Say whether a kernel has been compiled before, by this version on this machine."""
    function = dispatcher.py_func
    module = function.__module__.rpartition('.')[2]
    pattern = f'{module}.{function.__qualname__}-{function.__code__.co_firstlineno}.*.nbi'
    return any(Path(numba.config.CACHE_DIR).glob(pattern))
