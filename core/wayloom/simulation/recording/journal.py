"""Resume journal of a simulation: the run's settings, and how many frames of each drive are whole."""

import fcntl
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from wayloom.errors import ConflictError, LogError
from wayloom.files.atomic import write_atomically

RECORD_NAME: Final = "simulation.json"
Factors = tuple[float, float]


def check_record(out_dir: Path, record: dict[str, Any]) -> None:
    """Compare a run's settings with those of an earlier run in out_dir. Raises LogError where they differ."""
    file, wanted = out_dir / RECORD_NAME, json.loads(record_text(record))
    if not file.exists():
        return
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        found = None
    if found != wanted:
        what = f"the folder was simulated with other settings ({difference(found, wanted)})"
        raise LogError(what, file=file, remedy="give another folder, or remove this one")


def write_record(out_dir: Path, record: dict[str, Any]) -> None:
    """Write a run's settings."""
    write_atomically(out_dir / RECORD_NAME, record_text(record).encode())


def record_text(record: dict[str, Any]) -> str:
    """A run's settings as JSON text."""
    return json.dumps(record, indent=1, sort_keys=True) + "\n"


def difference(found: Any, wanted: Any, where: str = "") -> str:
    """The first place in which two values of JSON differ, in words."""
    if isinstance(found, dict) and isinstance(wanted, dict):
        for key in sorted({*found, *wanted}):
            if key not in found or key not in wanted or found[key] != wanted[key]:
                return difference(found.get(key), wanted.get(key), f"{where}.{key}" if where else key)
    if isinstance(found, list) and isinstance(wanted, list) and len(found) == len(wanted):
        k = next(k for k in range(len(found)) if found[k] != wanted[k])
        return difference(found[k], wanted[k], f"{where}[{k}]")
    return f"{where or 'all'}: {_short(found)}, not {_short(wanted)}"


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else text[:40] + "…"


@contextmanager
def sole_run(out_dir: Path) -> Iterator[None]:
    """Lock out_dir for this process, until it ends in whatever way. Raises ConflictError where another process holds it."""
    handle = os.open(out_dir, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        what = f"{out_dir}: another simulation is writing there; wait for it or choose another folder"
        raise ConflictError(what) from None
    try:
        yield
    finally:
        os.close(handle)


class Journal:
    """One line for each finished frame: its number and the exposure factors, left and right."""

    def __init__(self, file: Path) -> None:
        self.factors: list[Factors] = []
        file.parent.mkdir(parents=True, exist_ok=True)
        lines = file.read_bytes().split(b"\n")[:-1] if file.exists() else []  # what follows the last line's end was cut
        for line in lines:
            words = line.split()
            if len(words) != 3 or words[0] != str(len(self.factors)).encode():
                break
            self.factors.append((float(words[1]), float(words[2])))
        write_atomically(file, b"".join(_line(k, factors) for k, factors in enumerate(self.factors)))
        self._stream = file.open("ab", buffering=0)

    def __len__(self) -> int:
        return len(self.factors)

    def add(self, factors: Factors) -> None:
        """Record that the next frame is finished."""
        self._stream.write(_line(len(self.factors), factors))
        self.factors.append(factors)

    def close(self) -> None:
        """Close the file."""
        self._stream.close()


def _line(frame: int, factors: Factors) -> bytes:
    return f"{frame} {factors[0]!r} {factors[1]!r}\n".encode()
