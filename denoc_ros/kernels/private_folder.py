"""Folders that nobody else can write to: the compiled code in them is run."""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from pathlib import Path

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
