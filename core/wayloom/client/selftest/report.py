"""All checks and drills of one service, with their verdicts."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from wayloom.client.selftest.drills import DRILLS
from wayloom.client.selftest.subject import FailedCheckError, Subject
from wayloom.client.selftest.tus_checks import CHECKS, Check
from wayloom.errors import ServiceError


@dataclass(frozen=True, slots=True)
class Verdict:
    """Of one check: `passed`, `failed`, `not offered` by the service or `not tried` here, and what was found or why not."""

    kind: str
    name: str
    asks: str
    verdict: str
    found: str = ""


def tried(subject: Subject) -> Iterator[Verdict]:
    """Every check and drill, one after the other. One that fails does not end the others."""
    for kind, checks in (("tus", CHECKS), ("drill", DRILLS)):
        for check in checks:
            yield _verdict(subject, kind, check)


def _verdict(subject: Subject, kind: str, check: Check) -> Verdict:
    if check.extension is not None and check.extension not in subject.extensions:
        return Verdict(kind, check.name, check.asks, "not offered", f"no extension {check.extension}")
    try:
        check.run(subject)
    except (FailedCheckError, ServiceError) as error:
        return Verdict(kind, check.name, check.asks, "failed", str(error))
    except (ValueError, KeyError) as error:  # of what the service has answered: no JSON, no number, no header
        return Verdict(kind, check.name, check.asks, "failed", f"an answer could not be read: {type(error).__name__}: {error}")
    return Verdict(kind, check.name, check.asks, "passed")


def as_json(url: str, verdicts: Sequence[Verdict], removed: bool) -> dict[str, Any]:
    """The report as it is written to a file. removed : whether the service is without the drives that were sent"""
    failed = sum(one.verdict == "failed" for one in verdicts)
    return {
        "url": url,
        "passed": failed == 0,
        "failed": failed,
        "drive_removed": removed,
        "checks": [asdict(one) for one in verdicts],
    }
