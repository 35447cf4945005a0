"""Where compiled kernels are kept: in a folder that nobody else may write to.

Numba reads its cache by `pickle`, which runs what it reads. A folder is therefore used only if it belongs to
this user, or to the administrator, and no other user may write into it.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import stat
from functools import cache
from pathlib import Path

__all__ = ["own_folder", "say_once"]

#: Permissions of a group and of all others to write.
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


@cache
def say_once(sentence: str) -> None:
    """A warning on the log, once in a process; its workers, which meet the same folder, are silent."""
    if multiprocessing.parent_process() is None:
        logging.getLogger("offroad_env").warning(sentence)


@cache
def own_folder(folder: str) -> bool:
    """Whether compiled kernels may be kept in a folder, which is made where it is missing."""
    problem = _problem(Path(folder))
    if problem:
        # The parent: one sentence, not one for each module.
        say_once(
            f"compiled kernels are not kept in {Path(folder).parent}: {problem}. Each process compiles its "
            "own; OFFROAD_CACHE names another folder"
        )
    return not problem


def _problem(folder: Path) -> str:
    """Why a folder is not used; "" where it is."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError as error:
        return f"{error.strerror or error}"
    if not stat.S_ISDIR(found.st_mode):
        return "it is a link, not a folder"
    if hasattr(os, "geteuid"):
        if found.st_uid not in (os.geteuid(), 0):
            return "it belongs to another user, and a cache can run code"
        if found.st_mode & _OTHERS_WRITE:
            return "other users may write there, and a cache can run code (chmod -R go-w)"
    return "" if os.access(folder, os.W_OK | os.X_OK) else "it cannot be written to"
