"""Reading of foreign files, run as a process of its own.

`child_reader.py SCRIPT FOLDER MEMORY FILE...`: SCRIPT has a function `read(file)` that returns
arrays by name. Those of the k-th file are written to FOLDER/k.npz, what was wrong with it to
FOLDER/k.txt. MEMORY [bytes] bounds the address space and each file written; 0: no bounds. With
bounds it opens regular files only, and neither connects nor starts anything.

It imports nothing of the package, which need not be on the path of this process.
"""

from __future__ import annotations

import os
import resource
import runpy
import stat
import sys
import time
import warnings
from pathlib import Path

import numpy as np

FORBIDDEN = ('socket.', 'subprocess.', 'os.exec', 'os.fork', 'os.posix_spawn', 'os.system')
CPU_S = 60  # processor time for one file: the largest meshes in use take a tenth


def refuse(event: str, arguments: tuple[object, ...]) -> None:
    """Raise PermissionError for what reading a mesh never needs; an audit hook.

    A file may name others to be read with it: a pipe or a device would never end.
    """
    if event.startswith(FORBIDDEN):
        raise PermissionError(f'reader must only read, got {event}')
    path = arguments[0] if event == 'open' and arguments else None
    if isinstance(path, (str, bytes)) and os.path.exists(path):
        mode = os.stat(path).st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise PermissionError(f'reader must open regular files, got {os.fsdecode(path)}')


def main() -> None:
    """Read each file; a failure of one leaves the others readable."""
    script, folder, memory, *files = sys.argv[1:]
    bounded = int(memory) > 0
    if bounded:
        for kind in (resource.RLIMIT_AS, resource.RLIMIT_FSIZE):
            resource.setrlimit(kind, (int(memory), int(memory)))
        sys.addaudithook(refuse)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    warnings.simplefilter('ignore')
    for k, file in enumerate(files):
        if bounded:
            most = int(time.process_time()) + CPU_S
            resource.setrlimit(resource.RLIMIT_CPU, (most, resource.RLIM_INFINITY))
        made = Path(folder, f'{k}.npz')
        try:
            found = runpy.run_path(script)['read'](file)
            np.savez(made, np.array(list(found), dtype=np.str_), *map(np.asarray, found.values()))
        except (Exception, SystemExit) as error:
            made.unlink(missing_ok=True)
            text = 'more memory than allowed' if isinstance(error, MemoryError) else str(error)
            Path(folder, f'{k}.txt').write_text(text or type(error).__name__, encoding='utf-8')


if __name__ == '__main__':
    main()
