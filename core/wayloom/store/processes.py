"""Identity of a worker process, by which another process of the same machine can see that it has died."""

import os
import socket
from functools import cache
from pathlib import Path
from typing import Final

GONE: Final = "gone"


def identity(pid: int | None = None) -> str:
    """Host, boot, process id and start time of a process (this one by default): no two processes ever share it."""
    pid = os.getpid() if pid is None else pid
    return f"{_machine()}|{pid}|{_start_time(pid)}"


def is_dead(worker: str) -> bool:
    """Whether the process certainly no longer runs. False where that cannot be known, as on another machine."""
    machine, _, process = worker.partition("|")
    pid, _, started = process.partition("|")
    if machine != _machine():
        return False
    now = _start_time(int(pid))
    return now == GONE or (now != "" and now != started)


def name_of(worker: str) -> str:
    """Host and process id, for people."""
    machine, _, process = worker.partition("|")
    return f"{machine.partition('/')[0]} pid {process.partition('|')[0]}"


@cache
def _machine() -> str:
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        boot = "unknown"
    return f"{socket.gethostname()}/{boot}"


def _start_time(pid: int) -> str:
    """Clock ticks from boot to the process's start; empty where there is no such process or no /proc. A zombie counts as gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return GONE if Path("/proc/self/stat").exists() else ""
    return GONE if fields[0] in "ZX" else fields[19]
