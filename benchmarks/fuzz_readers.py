"""Random damage to logs of every format, for as long as one likes.

    python benchmarks/fuzz_readers.py --minutes 10 [--seed N] [--format euroc]

A log may be read, or refused in one line with a code of `wayloom.files.reasons`; anything else ends the run with the damaged file
beside its traceback, and the seed that makes it again. Prints how many damaged logs there were of each format, and what came of
them.
"""

import argparse
import random
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from logs.spoiling import made_logs, read_all, spoilt

SLOW_S = 10.0


def main() -> None:
    """Damage a file of a log, read the log, mend the file; until time is up."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--format", help="only this one")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        drives = {kind: drive for kind, drive in made_logs(Path(folder)).items() if arguments.format in (None, kind)}
        files = {kind: sorted(file for file in drive.rglob("*") if file.is_file()) for kind, drive in drives.items()}
        outcomes: dict[str, Counter[str]] = {kind: Counter() for kind in drives}
        slowest, seed, until = 0.0, arguments.seed, time.monotonic() + 60 * arguments.minutes
        while time.monotonic() < until:
            kind = sorted(drives)[seed % len(drives)]
            took_s, outcome = run_one(seed, kind, drives[kind], files[kind])
            outcomes[kind][outcome] += 1
            slowest, seed = max(slowest, took_s), seed + 1
    for kind, counts in outcomes.items():
        told = ", ".join(f"{reason} {count}" for reason, count in counts.most_common())
        print(f"{kind:22s} {counts.total():6d} damaged logs: {told}")
    print(f"slowest {slowest:.2f} s; seeds {arguments.seed} to {seed - 1}")


def run_one(seed: int, kind: str, drive: Path, files: list[Path]) -> tuple[float, str]:
    """Seconds, and what came of one damaged log."""
    dice = random.Random(seed)
    small = [file for file in files if file.suffix.lower() not in (".png", ".jpg")]
    file = dice.choice(small if dice.random() < 0.8 and small else files)
    whole = file.read_bytes()
    file.write_bytes(spoilt(whole, dice))
    began = time.monotonic()
    try:
        outcome = read_all(drive)
    except BaseException:
        kept = Path(tempfile.gettempdir()) / f"fuzzed-{kind}-{seed}-{file.name}"
        shutil.copy(file, kept)
        print(f"seed {seed}: {file.relative_to(drive)} of {kind}, kept as {kept}", file=sys.stderr)
        raise
    finally:
        file.write_bytes(whole)
    took_s = time.monotonic() - began
    if took_s > SLOW_S:
        raise RuntimeError(f"seed {seed}: {file.relative_to(drive)} of {kind} took {took_s:.1f} s")
    return took_s, outcome


if __name__ == "__main__":
    main()
