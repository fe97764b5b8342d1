"""Random damage to bytes, and every format's reader under it."""

import random
from pathlib import Path

from logs.made_drives import sample_files, track_file, write_drive
from logs.ros2.foxglove_kit import record
from wayloom.errors import InputError
from wayloom.files.reasons import REASONS
from wayloom.logs.damage import without_damage
from wayloom.logs.inspection import inspect_log
from wayloom.logs.registry import open_log_unchecked

WORDS = (
    b"nan", b"-", b"1e308", b"1e-308", b"inf", b"\x00", b"\n", b" 0 ", b"9" * 30, "\u0663".encode(), b"\xff", b"e", b"[", b"]",
    b'"', b"{", b",", b":", b"#", b"../", b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\x00" * 8, b"&a", b"*a", b"-1", b"1e99999",
)  # fmt: skip


def spoilt(data: bytes, dice: random.Random) -> bytes:
    """The bytes with one to four damages: cut, flipped, doubled, overwritten, with words put in or lines taken out."""
    out = bytearray(data)
    for _ in range(dice.choice((1, 1, 1, 2, 4))):
        at, kind = dice.randrange(len(out) + 1), dice.randrange(7)
        if kind == 0:
            del out[at:]
        elif kind == 1 and out:
            for _ in range(dice.randint(1, 6)):
                out[dice.randrange(len(out))] = dice.randrange(256)
        elif kind == 2:
            out[at:at] = out[at : at + dice.randint(1, 200)]
        elif kind == 3:
            out[at:at] = dice.choice(WORDS)
        elif kind == 4:
            word = dice.choice(WORDS)
            out[at : at + len(word)] = word
        elif kind == 5:
            del out[at : at + dice.randint(1, 40)]
        else:
            lines = bytes(out).split(b"\n")
            lines[dice.randrange(len(lines))] = dice.choice((b"", lines[dice.randrange(len(lines))]))
            out = bytearray(b"\n".join(lines))
    return bytes(out)


def made_logs(folder: Path) -> dict[str, Path]:
    """A drive of each format, and one with every table beside it."""
    made = {kind: write_drive(folder / kind, kind) for kind in ("kitti-odometry", "kitti-raw", "kitti-360", "euroc", "mcap")}
    for kind in ("kitti-odometry", "euroc"):
        drive = write_drive(folder / f"{kind}-tables", kind, gnss=False)
        track_file(drive / "gnss.csv")
        sample_files(drive)
        made[f"{kind}-tables"] = drive
    for encoding in ("protobuf", "json"):
        made[f"foxglove-{encoding}"] = folder / f"foxglove-{encoding}"
        made[f"foxglove-{encoding}"].mkdir()
        record(made[f"foxglove-{encoding}"] / "drive.mcap", encoding, raw=False)
    return made


def read_all(drive: Path) -> str:
    """Open a log, leave damaged frames out, look at everything: "read", or the reason for which it is refused.

    Whatever else comes of it is a fault of the reader's.
    """
    try:
        log = without_damage(open_log_unchecked(drive))
        report = inspect_log(log)
    except InputError as problem:
        refused = problem
    else:
        return "read" if report.usable else report.damaged[0].reason
    assert "\n" not in str(refused), str(refused)
    assert refused.reason in REASONS
    return refused.reason
