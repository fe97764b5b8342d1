"""What a command compiles, kernel by kernel, from an empty cache; and how long it takes to its first image with a full one.

    python benchmarks/compilation.py [--rows 20] [--warm 3] COMMAND …

COMMAND  of `wayloom`, with its options: `odometry LOG --out t.tum`, `simulate demo --out FOLDER`, `process LOG --out FOLDER`
--rows   kernels in the table, those that take longest
--warm   runs with the cache that the first one filled; the fastest is told

Seconds are processor time of one thread: of a kernel itself, what it calls left out. The first image is the first that the odometry
asks its log for; the first frame is the first that is tracked, after the lens has been learnt from pieces of the drive.
"""

import argparse
import atexit
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]


def main() -> None:
    """Run the command from an empty cache, then again, and print what was measured."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=20)
    parser.add_argument("--warm", type=int, default=3)
    parser.add_argument("--into", type=Path, help=argparse.SUPPRESS)  # what the processes that are measured are called with
    parser.add_argument("command", nargs=argparse.REMAINDER)
    options = parser.parse_args()
    if not options.command:
        parser.error("which command of wayloom?")
    if options.into is not None:
        measured(options.into, options.command)
        return
    with tempfile.TemporaryDirectory(prefix="wayloom-compilation-") as cache:
        print_compilation(run(Path(cache), options.command), options.rows)
        print_starts([run(Path(cache), options.command) for _ in range(options.warm)])


def run(cache: Path, command: list[str]) -> dict[str, Any]:
    """What a process of its own measured, its kernels in this folder."""
    out = cache / "measured.json"
    path = os.pathsep.join(str(ROOT / name) for name in ("core", "services", "workers"))
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": path}
    process = [sys.executable, __file__, "--into", str(out), *command]
    subprocess.run(process, env=environment, check=True, stdout=subprocess.DEVNULL)
    return dict(json.loads(out.read_text()))


def measured(out: Path, command: list[str]) -> None:
    """Run a command of wayloom in this process; every compilation and the two moments go into the file `out` at its end."""
    start, moments, rows = time.monotonic(), {}, list[tuple[str, str, float]]()

    def note(name: str) -> None:
        moments.setdefault(name, (time.monotonic() - start, time.process_time()))

    def write() -> None:
        out.write_text(json.dumps({"rows": rows, "moments": moments, "cpu_s": time.process_time()}))

    from wayloom.cli.main import main as wayloom

    listen(rows)
    if command[0] in ("odometry", "process"):
        from wayloom.odometry import frame_source

        frame_source.grey_pair = noted(frame_source.grey_pair, lambda: note("first image"))
        frame_source.frames = noted_at_first(frame_source.frames, lambda: note("first frame"))
    atexit.register(write)
    sys.argv = ["wayloom", *command]
    wayloom()


def listen(rows: list[tuple[str, str, float]]) -> None:
    """Add module, name and seconds of every function that numba compiles to rows, without those compiled meanwhile."""
    from numba.core import event

    stack: list[tuple[float, list[float]]] = []

    class Listener(event.Listener):  # type: ignore[misc]
        def on_start(self, _event: event.Event) -> None:
            stack.append((time.thread_time(), [0.0]))

        def on_end(self, compiled: event.Event) -> None:
            began, within = stack.pop()
            seconds, function = time.thread_time() - began, compiled.data["dispatcher"].py_func
            if stack:
                stack[-1][1][0] += seconds
            rows.append((function.__module__, function.__qualname__, seconds - within[0]))

    event.register("numba:compile", Listener())


def noted(function: Callable[..., Any], note: Callable[[], None]) -> Callable[..., Any]:
    """The function, which notes its calls."""

    def call(*arguments: Any, **named: Any) -> Any:
        note()
        return function(*arguments, **named)

    return call


def noted_at_first(function: Callable[..., Iterator[Any]], note: Callable[[], None]) -> Callable[..., Iterator[Any]]:
    """The generator function, which notes that a value is given."""

    def call(*arguments: Any, **named: Any) -> Iterator[Any]:
        for value in function(*arguments, **named):
            note()
            yield value

    return call


def print_compilation(cold: dict[str, Any], count: int) -> None:
    """Two tables: by room and by kernel."""
    rooms, kernels = defaultdict[str, list[float]](list), defaultdict[str, list[float]](list)
    for module, name, seconds in cold["rows"]:
        place = module.split(".")
        rooms[place[1] if place[0] == "wayloom" else f"{place[0]}'s own"].append(seconds)
        kernels[f"{'.'.join(place[1:]).replace('.kernels', '')}.{name}"].append(seconds)
    total = sum(sum(seconds) for seconds in rooms.values())
    print(
        f"{total:.1f} s of {cold['cpu_s']:.1f} s processor time for {len(cold['rows'])} compilations of {len(kernels)} functions\n"
    )
    for title, table, most in (("room", rooms, len(rooms)), ("kernel", kernels, count)):
        print(f"| {title} | compilations | s |\n| --- | --- | --- |")
        for name, seconds in sorted(table.items(), key=lambda item: -sum(item[1]))[:most]:
            print(f"| {name} | {len(seconds)} | {sum(seconds):.2f} |")
        print()


def print_starts(warm: list[dict[str, Any]]) -> None:
    """The fastest start with a full cache."""
    for name in warm[0]["moments"] if warm else ():
        wall, cpu = (min(run["moments"][name][k] for run in warm) for k in (0, 1))
        print(f"{name}, kernels compiled before: {wall:.2f} s, {cpu:.2f} s processor time")
    if warm and any(run["rows"] for run in warm):
        print(f"compiled again: {sorted({name for run in warm for _, name, _ in run['rows']})}")


if __name__ == "__main__":
    main()
