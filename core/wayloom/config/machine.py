"""Cores and memory of this machine."""

import os
from contextlib import suppress
from pathlib import Path
from typing import Final

CONTROL_GROUPS: Final = (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"))


def machine_memory() -> int:
    """Bytes of memory of the machine, or of the control group where that is less; 0 where the system says neither."""
    try:
        total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (OSError, ValueError):
        return 0
    for file in CONTROL_GROUPS:
        with suppress(OSError, ValueError):
            total = min(total, int(file.read_text()))
    return max(total, 0)
