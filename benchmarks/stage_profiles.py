"""Where each stage of a drive spends its time: flame graphs, and the three functions in which most of it passes.

    python benchmarks/stage_profiles.py LOG [--gnss PATH] [--model NAME] [--rate 200] [--write]

LOG     a drive log; the committed pictures are of clip A, the first 201 frames of KITTI's odometry sequence 00
--write puts the pictures into docs/pictures/profiles and the table into docs/benchmarks/cost.md

Samples are taken by py-spy (`pip install py-spy`) of a run on one core whose kernels are compiled. A compiled kernel or a library
has no frames of its own: its time is that of the Python function that calls it. The start of the process, and threads that work
ahead of a stage, are told by themselves.
"""

import argparse
import html
import os
import re
import shutil
import subprocess
import sys
import tempfile
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from pages import DOCS, put_between_marks

ROOT: Final = Path(__file__).resolve().parents[1]
PICTURES: Final = DOCS / "pictures" / "profiles"
BESIDE: Final = "start and threads beside"
LEAST_SHARE: Final = 0.01
"""Of the drive, for a picture of its own."""
WIDTH, ROW, FONT, LETTER = 1200, 18, 11, 6.2
LEAST_WIDTH: Final = 1.5
"""Pixels: what is narrower is left out."""
Stack = tuple[str, ...]


@dataclass
class Node:
    """A function with the samples in it and in what it calls, and those calls."""

    count: int = 0
    calls: dict[str, "Node"] = field(default_factory=dict)


def main() -> None:
    """Profile, and print or write what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=Path)
    parser.add_argument("--gnss", type=Path)
    parser.add_argument("--model")
    parser.add_argument("--rate", type=int, default=200)
    parser.add_argument("--write", action="store_true")
    args = parser.parse_args()
    if (profiler := shutil.which("py-spy")) is None:
        raise SystemExit("py-spy is missing: pip install py-spy")
    more = [*(["--gnss", str(args.gnss)] if args.gnss else []), *(["--model", args.model] if args.model else [])]
    with tempfile.TemporaryDirectory() as scratch:
        run([sys.executable, ROOT / "benchmarks" / "drive_cost.py", args.log, Path(scratch) / "first", *more])  # compiles
        folded = Path(scratch) / "folded"
        drive = [sys.executable, ROOT / "benchmarks" / "drive_cost.py", args.log, Path(scratch) / "second", *more]
        run([profiler, "record", "--format", "raw", "--function", "--rate", args.rate, "--output", folded, "--", *drive])
        stages = by_stage(folded.read_text(encoding="utf-8").splitlines())
    total = sum(sum(stacks.values()) for stacks in stages.values())
    shown = {name: stacks for name, stacks in stages.items() if sum(stacks.values()) >= LEAST_SHARE * total}
    text = table(shown, total)
    print(text)
    if args.write:
        PICTURES.mkdir(parents=True, exist_ok=True)
        for name, stacks in shown.items():
            (PICTURES / f"{name.replace(' ', '-')}.svg").write_text(flame_graph(name, stacks), encoding="utf-8")
        put_between_marks(DOCS / "benchmarks" / "cost.md", "profiles", text)


def run(words: list[object]) -> None:
    """Run a command with the tree's own sources; its output is dropped."""
    paths = os.pathsep.join(str(ROOT / room) for room in ("core", "services", "workers"))
    environment = {**os.environ, "PYTHONPATH": paths, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run([*map(str, words)], env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{words[0]} failed:\n{done.stderr[-2000:]}")


def by_stage(lines: list[str]) -> dict[str, Counter[Stack]]:
    """For each stage its stacks, cut off above the stage's own function, with the samples in them."""
    found: dict[str, Counter[Stack]] = {}
    for line in lines:
        stack, _, count = line.rpartition(" ")
        frames = stack.split(";")
        at, stage = next(((i, name) for i, frame in enumerate(frames) if (name := stage_of(frame))), (0, BESIDE))
        if stage == BESIDE and not any("wayloom/" in frame for frame in frames):
            continue  # the interpreter's start and end
        cut = tuple(readable(frame) for frame in frames[at:] if "frozen " not in frame)
        found.setdefault(stage, Counter())[cut] += int(count)
    return found


def stage_of(frame: str) -> str | None:
    """The stage whose function this is."""
    if match := re.search(r"wayloom/pipeline/stages/(\w+)\.py", frame):
        return match[1]
    return "exports" if re.match(r"write_products \(.*wayloom/pipeline/drive_products\.py", frame) else None


def readable(frame: str) -> str:
    """`function (room.module)` of a frame of py-spy's."""
    match = re.fullmatch(r"(.+) \((.+?)(?::\d+)?\)", frame)
    if match is None:
        return frame
    path = re.sub(r"^.*?(?:core/|site-packages/|lib/python3\.\d+/)", "", match[2]).removesuffix(".py")
    return f"{match[1]} ({path.replace('/', '.').removeprefix('wayloom.')})"


def table(stages: dict[str, Counter[Stack]], total: int) -> str:
    """Markdown: the share of each stage, and its three functions with most samples of their own."""
    rows = ["| stage | share of samples | most of it in |", "| --- | --- | --- |"]
    for name, stacks in sorted(stages.items(), key=lambda item: -sum(item[1].values())):
        count = sum(stacks.values())
        own = Counter[str]()
        for stack, samples in stacks.items():
            own[stack[-1]] += samples
        pieces = ", ".join(f"`{piece}` {samples / count:.0%}" for piece, samples in own.most_common(3))
        rows.append(f"| [{name}](../pictures/profiles/{name.replace(' ', '-')}.svg) | {count / total:.1%} | {pieces} |")
    return "\n".join(rows)


def flame_graph(name: str, stacks: Counter[Stack]) -> str:
    """SVG: a function is as wide as the samples in it, what it calls stands below it, in the order of the names."""
    root = Node()
    for stack, samples in stacks.items():
        node = root
        node.count += samples
        for frame in stack:
            node = node.calls.setdefault(frame, Node())
            node.count += samples
    boxes = list(laid_out(root, 0.0, WIDTH / root.count, 0, root.count))
    height = (max(row for _, _, row, _, _ in boxes) + 2) * ROW + 8
    drawn = "".join(box(*one) for one in boxes)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="sans-serif" font-size="{FONT}">'
        f'<rect width="{WIDTH}" height="{height}" fill="#fff"/><text x="4" y="13" font-weight="bold">{html.escape(name)}: '
        f"{root.count} samples</text>{drawn}</svg>\n"
    )


def laid_out(node: Node, x: float, scale: float, row: int, whole: int) -> Iterator[tuple[float, float, int, str, float]]:
    """Left edge, width, row, name and share of what a node calls, and of what that calls."""
    for frame, call in sorted(node.calls.items()):
        width = call.count * scale
        if width >= LEAST_WIDTH:
            yield x, width, row, frame, call.count / whole
            yield from laid_out(call, x, scale, row + 1, whole)
        x += width


def box(x: float, width: float, row: int, frame: str, share: float) -> str:
    """One function, coloured by its room."""
    y, letters = (row + 1) * ROW + 2, int((width - 6) / LETTER)
    room = re.sub(r".*\((\w+).*", r"\1", frame)
    hue = zlib.crc32(room.encode()) % 360
    label = frame if len(frame) <= letters else frame[: max(0, letters - 1)] + "…"
    text = f'<text x="{x + 3:.1f}" y="{y + 13}">{html.escape(label)}</text>' if letters > 3 else ""
    title = f"<title>{html.escape(frame)}: {share:.1%}</title>"
    fill = f'fill="hsl({hue} 60% 78%)" stroke="#fff" stroke-width="0.6"'
    return f'<g><rect x="{x:.1f}" y="{y}" width="{width:.1f}" height="{ROW - 1}" {fill}>{title}</rect>{text}</g>'


if __name__ == "__main__":
    main()
