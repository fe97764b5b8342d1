"""Random damage to logs of every format, for as long as one likes.

    python benchmarks/fuzz_readers.py --minutes 10 [--seed N] [--format euroc] [--write]

A log may be read, or refused in one line with a code of `wayloom.files.reasons`; anything else ends the run with the damaged file
beside its traceback, and the seed that makes it again (`--seed N --format FORMAT`). The formats share the time equally, by the
processor's clock, so that a run of low priority says what it did. Prints how many damaged logs there were of each, and what came of
them; ends early, with its table, when it is told to stop.
"""

import argparse
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from logs.spoiling import made_logs, read_all, spoilt
from pages import DOCS, put_between_marks

PAGE = DOCS / "benchmarks" / "fuzzed_logs.md"
SLOW_S = 10.0


@dataclass
class Tally:
    """Of one format: the processor's seconds that its damaged logs took, the slowest of them, and what came of them."""

    seconds: float = 0.0
    slowest_s: float = 0.0
    outcomes: Counter[str] = field(default_factory=Counter)


def main() -> None:
    """Damage a file of a log, read the log, mend the file; until time is up."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--format", help="only this one")
    parser.add_argument("--write", action="store_true", help="into the page")
    arguments = parser.parse_args()
    stopped: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: stopped.append(number))
    with tempfile.TemporaryDirectory() as folder:
        drives = {kind: drive for kind, drive in made_logs(Path(folder)).items() if arguments.format in (None, kind)}
        files = {kind: sorted(file for file in drive.rglob("*") if file.is_file()) for kind, drive in drives.items()}
        tallies = {kind: Tally() for kind in sorted(drives)}
        seed, until = arguments.seed, time.monotonic() + 60 * arguments.minutes
        while time.monotonic() < until and not stopped:
            kind = min(tallies, key=lambda name: tallies[name].seconds)
            took_s, outcome = run_one(seed, kind, drives[kind], files[kind])
            tallies[kind].outcomes[outcome] += 1
            tallies[kind].seconds += took_s
            tallies[kind].slowest_s = max(tallies[kind].slowest_s, took_s)
            seed += 1
    text = "\n".join(table(tallies))
    print(f"{text}\nseeds {arguments.seed} to {seed - 1}")
    if arguments.write:
        put_between_marks(PAGE, "fuzz", f"Seeds {arguments.seed} to {seed - 1}.\n\n{text}")


def table(tallies: dict[str, Tally]) -> list[str]:
    """A row a format."""
    lines = [
        "| format | minutes | damaged logs | read | refused, by reason | slowest, s |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for kind, tally in tallies.items():
        refused = ", ".join(f"{reason} {count}" for reason, count in tally.outcomes.most_common() if reason != "read")
        counts = f"{tally.outcomes.total()} | {tally.outcomes['read']} | {refused}"
        lines.append(f"| {kind} | {tally.seconds / 60:.1f} | {counts} | {tally.slowest_s:.2f} |")
    return lines


def run_one(seed: int, kind: str, drive: Path, files: list[Path]) -> tuple[float, str]:
    """The processor's seconds, and what came of one damaged log."""
    dice = random.Random(seed)
    small = [file for file in files if file.suffix.lower() not in (".png", ".jpg")]
    file = dice.choice(small if dice.random() < 0.8 and small else files)
    whole = file.read_bytes()
    file.write_bytes(spoilt(whole, dice))
    began = time.process_time()
    try:
        outcome = read_all(drive)
    except BaseException:
        kept = Path(tempfile.gettempdir()) / f"fuzzed-{kind}-{seed}-{file.name}"
        shutil.copy(file, kept)
        print(f"seed {seed}: {file.relative_to(drive)} of {kind}, kept as {kept}", file=sys.stderr)
        raise
    finally:
        file.write_bytes(whole)
    took_s = time.process_time() - began
    if took_s > SLOW_S:
        raise RuntimeError(f"seed {seed}: {file.relative_to(drive)} of {kind} took {took_s:.1f} s")
    return took_s, outcome


if __name__ == "__main__":
    main()
