"""Start of Python processes that import nothing from the folder they are started in.

`python -m` and `python -c` put that folder first on the path: whoever wrote an `html.py` there
would have it executed. `PYTHONSAFEPATH` prevents it from Python 3.11 on only.
"""

from __future__ import annotations

import sys

# The entry '' is the working folder; it is taken out before anything is imported.
_START = 'import sys; sys.path[:] = filter(None, sys.path); del sys.argv[0]; '
_RUN_MODULE = 'import runpy; runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)'
_RUN_FILE = 'import runpy; runpy.run_path(sys.argv[0], run_name="__main__")'


def module_words(module: str, *arguments: str) -> list[str]:
    """Return the words after the interpreter that run a module, as `python -m MODULE` does."""
    return ['-c', _START + _RUN_MODULE, module, *arguments]


def file_command(file: str, *arguments: str) -> list[str]:
    """Return the command that runs a file, without its folder on the path."""
    return [sys.executable, '-c', _START + _RUN_FILE, file, *arguments]


def code_command(code: str) -> list[str]:
    """Return the command that runs code; `sys.argv` is empty."""
    return [sys.executable, '-c', _START + code]
