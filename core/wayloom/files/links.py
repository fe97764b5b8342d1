"""Symbolic links that lead out of a folder."""

import os
from collections.abc import Iterable, Iterator
from functools import lru_cache
from pathlib import Path


def leading_out(files: Iterable[Path], root: Path) -> Iterator[Path]:
    """Those of the files, which lie below `root` by their names, that a link of their own or of a folder on the way puts elsewhere.

    `root` itself may be reached by links.
    """
    inside = os.path.realpath(root)

    @lru_cache(1024)
    def real(folder: str) -> str:
        return os.path.realpath(folder)

    for file in files:
        folder, name = os.path.split(file)
        path = os.path.join(real(folder), name)
        path = os.path.realpath(path) if os.path.islink(path) else path
        if os.path.commonpath([inside, path]) != inside:
            yield file
