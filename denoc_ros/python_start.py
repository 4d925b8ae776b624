"""Start of Python processes that import nothing from the folder they are started in.

`python -m` and `python -c` put that folder first on the path: whoever wrote an `html.py` there
would have it executed. `PYTHONSAFEPATH` prevents it from Python 3.11 on only.
"""

from __future__ import annotations

# The entry '' is the working folder; it is taken out before anything is imported.
_INSTALLED_ONLY = 'import sys; sys.path[:] = filter(None, sys.path); '
_RUN = 'del sys.argv[0]; import runpy; runpy.run_'
_RUN_MODULE = _RUN + 'module(sys.argv[0], run_name="__main__", alter_sys=True)'
_RUN_FILE = _RUN + 'path(sys.argv[0], run_name="__main__")'


def code_words(code: str, *arguments: str) -> list[str]:
    """Return the words after the interpreter that run code, as `python -c CODE` does."""
    return ['-c', _INSTALLED_ONLY + code, *arguments]


def module_words(module: str, *arguments: str) -> list[str]:
    """Return the words after the interpreter that run a module, as `python -m MODULE` does."""
    return code_words(_RUN_MODULE, module, *arguments)


def file_words(file: str, *arguments: str) -> list[str]:
    """Return the words after the interpreter that run a file, its folder not on the path."""
    return code_words(_RUN_FILE, file, *arguments)
