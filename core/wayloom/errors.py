"""The one error tree of wayloom. A message says what happened, with the numbers, and what to do next.

WayloomError                    anything that wayloom itself reports                   exit 1
├── InputError                  what the user gave cannot be used                      exit 2
│   ├── LogError                a drive log, or a file in it
│   ├── CalibrationError        a camera or rig calibration
│   ├── ModelError              a network or its description
│   ├── ConfigError             a setting
│   ├── MissingExtraError       packages of an extra that is not installed
│   └── UnknownFormatError      nothing that wayloom knows was recognised
├── StageError                  a stage of the pipeline cannot go on
│   └── TooFewKeyframesError    the odometry left nothing to map
├── NotFoundError               a drive, upload, tile or map version that does not exist
│   └── WithdrawnError          a map version that held a drive which was removed
├── ConflictError               the state of the thing forbids the request
│   └── OffsetConflictError     an upload continues at another byte than it ended
├── ChecksumMismatchError       bytes that came are not those that were announced
├── LeaseLostError              another worker has taken over the job
└── ServiceError                a server answered with an error or not at all
"""

import unicodedata
from pathlib import Path
from typing import Final

UNSEEN: Final = frozenset({"Cc", "Cf", "Zl", "Zp"})
"""Categories of characters that break lines or steer terminals."""


class WayloomError(Exception):
    """Anything that wayloom itself reports. `code` is stable and machine-readable."""

    code = "error"


class InputError(WayloomError):
    """What the user gave cannot be used. The message is one line: the file, the record in it, what is wrong, the remedy.

    `reason` is a stable code of `wayloom.files.reasons`, for programs that decide what to do with the file."""

    code = "bad-input"

    default_reason = "input.invalid"

    def __init__(
        self,
        what: str,
        *,
        file: Path | str | None = None,
        record: str | None = None,
        remedy: str | None = None,
        reason: str | None = None,
    ) -> None:
        self.what = what
        self.file = None if file is None else str(file)
        self.record = record
        self.remedy = remedy
        self.reason = reason or self.default_reason
        where = ", ".join(part for part in (self.file, record) if part)
        message = f"{where}: {what}" if where else what
        super().__init__(_on_one_line(f"{message}; {remedy}" if remedy else message))


def _on_one_line(text: str) -> str:
    """Text in which names out of files may stand, characters that nobody sees as escapes."""
    if text.isprintable():
        return text
    seen = (c if unicodedata.category(c) not in UNSEEN else c.encode("unicode_escape").decode() for c in text)
    return "".join(seen)


class LogError(InputError):
    """A drive log, or a file in it, is missing, damaged or contradicts itself."""

    code = "bad-log"
    default_reason = "log.invalid"


class CalibrationError(InputError):
    """A camera or rig calibration is missing or impossible."""

    code = "bad-calibration"
    default_reason = "calibration.invalid"


class ModelError(InputError):
    """A network or its description cannot be used."""

    code = "bad-model"
    default_reason = "model.invalid"


class ConfigError(InputError):
    """A setting is unknown, out of range or contradicts another."""

    code = "bad-config"
    default_reason = "config.invalid"


class MissingExtraError(InputError):
    """What is asked for needs packages that are not installed: those of an extra."""

    code = "missing-extra"
    default_reason = "extra.missing"


class UnknownFormatError(InputError):
    """Nothing that wayloom knows was recognised; the message lists what it knows."""

    code = "unknown-format"
    default_reason = "format.unknown"


class StageError(WayloomError):
    """A stage of the pipeline cannot go on with what the stage before it left."""

    code = "stage-failed"


class TooFewKeyframesError(StageError):
    """The odometry left too few keyframes to map."""

    code = "too-few-keyframes"


class NotFoundError(WayloomError):
    """A drive, upload, tile or map version that does not exist (or is not the caller's)."""

    code = "not-found"


class WithdrawnError(NotFoundError):
    """A map version that is not served any more, because it held a drive that was removed."""

    code = "withdrawn"


class ConflictError(WayloomError):
    """The state of the thing forbids the request."""

    code = "conflict"


class OffsetConflictError(ConflictError):
    """An upload was continued at another byte than the one at which its stored bytes end."""

    code = "offset-conflict"


class ChecksumMismatchError(WayloomError):
    """Bytes that came are not those that were announced: they are to be sent again."""

    code = "checksum-mismatch"


class LeaseLostError(WayloomError):
    """The job's lease ran out and another worker has taken it over: stop, and write nothing."""

    code = "lease-lost"


class ServiceError(WayloomError):
    """A server answered with an error or not at all."""

    code = "service-error"
