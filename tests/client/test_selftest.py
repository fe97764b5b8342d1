"""`wayloom selftest`: a service that does as tus asks passes, one that does not is told where."""

import json
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import httpx2
import pytest

from service_kit.running import ApiAlone, environment
from wayloom.client.selftest import drills
from wayloom.client.selftest.drills import CUTS, at_once, cut_links
from wayloom.client.selftest.report import tried
from wayloom.client.selftest.subject import FailedCheckError, Subject
from wayloom.errors import ServiceError

Answer = httpx2.Response
Lie = Callable[[str, Answer], None]


def selftest(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "wayloom.cli.main", "selftest", *map(str, arguments)]
    return subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=120)


def test_our_service_passes_every_check_and_drill(alone: ApiAlone) -> None:
    done = selftest(alone.url, "--json")
    report = json.loads(done.stdout)
    assert [one for one in report["checks"] if one["verdict"] != "passed"] == []
    assert done.returncode == 0
    assert report["drive_removed"]
    assert done.stderr.splitlines()[-1] == f"{len(report['checks'])} passed, 0 failed, 0 not offered"


def silent_about_its_version(_: str, answer: Answer) -> None:
    answer.headers.pop("tus-resumable", None)


def taking_any_offset(_: str, answer: Answer) -> None:
    answer.status_code = 204 if answer.status_code == 409 else answer.status_code


def one_byte_ahead(method: str, answer: Answer) -> None:
    if method == "HEAD" and answer.headers.get("upload-offset", "0") != "0":
        answer.headers["upload-offset"] = str(int(answer.headers["upload-offset"]) + 1)


def blind_to_sums(_: str, answer: Answer) -> None:
    answer.status_code = 204 if answer.status_code == 460 else answer.status_code


def without_expiry(_: str, answer: Answer) -> None:
    answer.headers.pop("upload-expires", None)


def without_location(method: str, answer: Answer) -> None:
    if method == "POST" and answer.headers.get("upload-offset") == "1000":
        answer.headers.pop("location", None)


def knowing_a_sum_that_we_do_not(_: str, answer: Answer) -> None:
    if "tus-checksum-algorithm" in answer.headers:
        answer.headers["tus-checksum-algorithm"] = answer.headers["tus-checksum-algorithm"].replace(",", " , ") + ", crc0"


@pytest.mark.parametrize(
    ("lie", "failing"),
    [
        (silent_about_its_version, {"stated version"}),
        (taking_any_offset, {"wrong offsets", "twice", "forgotten"}),
        (one_byte_ahead, {"wrong offsets", "method override", "first bytes", "cut links", "at once"}),
        (blind_to_sums, {"wrong sums", "flipped bit"}),
        (without_expiry, {"expiry"}),
        (without_location, {"first bytes"}),
        (knowing_a_sum_that_we_do_not, set()),
    ],
)
def test_a_service_that_does_not_is_told_where(alone: ApiAlone, lie: Lie, failing: set[str]) -> None:
    class Lying(Subject):
        """The same service behind a proxy that changes what it answers."""

        def send(self, method: str, path: str, headers: dict[str, str] | None = None, **more: Any) -> Answer:
            answer = super().send(method, path, headers, **more)
            lie(method, answer)
            return answer

    with Lying(alone.url) as subject:
        verdicts = list(tried(subject))
        subject.remove()
    assert {one.name: one.found for one in verdicts if one.verdict == "failed"}.keys() == failing


def test_bytes_of_a_cut_link_that_come_late_are_no_fault(alone: ApiAlone) -> None:
    class Late(Subject):
        """The same service, which comes to what a broken link brought only when the rest is on its way."""

        late = 3

        def patch(self, address: str, offset: int, content: bytes, **more: str) -> Answer:
            if self.late:
                self.late -= super().patch(address, offset, content[:1]).status_code == 204
            return super().patch(address, offset, content, **more)

    with Late(alone.url) as subject:
        cut_links(subject)
        subject.remove()
    assert subject.late == 0


def test_a_cut_link_of_which_nothing_is_kept_is_tried_with_more_patience(alone: ApiAlone, monkeypatch: pytest.MonkeyPatch) -> None:
    pauses: list[float] = []

    def starved(subject: Subject, address: str, offset: int, content: bytes, sent: int, pause_s: float) -> None:
        pauses.append(pause_s)
        if len(pauses) > CUTS:
            send_and_cut(subject, address, offset, content, sent, pause_s)

    send_and_cut = drills._sent_and_cut
    monkeypatch.setattr(drills, "_sent_and_cut", starved)
    with Subject(alone.url) as subject:
        cut_links(subject)
        subject.remove()
    assert len(pauses) > CUTS
    assert pauses[-1] > pauses[CUTS - 1]


def test_two_at_once_that_are_not_answered_fail(alone: ApiAlone) -> None:
    class Silent(Subject):
        """The same service, which answers no chunk."""

        def patch(self, address: str, offset: int, content: bytes, **more: str) -> Answer:
            super().patch(address, offset, content, **more)
            raise ServiceError("does not answer")

    with Silent(alone.url) as subject:
        with pytest.raises(FailedCheckError, match="neither of two"):
            at_once(subject)
        subject.remove()


def test_an_extension_that_is_not_offered_is_not_asked_for(alone: ApiAlone) -> None:
    with Subject(alone.url) as subject:
        subject.extensions -= {"checksum", "termination"}
        missing = {one.name for one in tried(subject) if one.verdict == "not offered"}
        subject.remove()
    assert missing == {"right sums", "wrong sums", "termination"}


def test_where_no_service_answers_one_line_says_so() -> None:
    done = selftest("http://127.0.0.1:9")
    assert done.returncode == 1
    assert done.stderr.startswith("wayloom: http://127.0.0.1:9 does not answer")
    assert done.stderr.count("\n") == 1
