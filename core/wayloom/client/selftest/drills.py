"""Drills of the way: links that break, chunks that come twice or at once, bytes that are not the file's."""

import random
import socket
import ssl
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Final
from urllib.parse import urlsplit

from wayloom.client.selftest.subject import CONTENT_TYPE, VERSION, Subject, expect
from wayloom.client.selftest.tus_checks import Check
from wayloom.errors import ServiceError

CUTS: Final = 5
FIRST_PAUSE_S: Final = 0.05
"""Between the last byte and the cut: bytes that a service has not taken yet are lost with the link. Twice as long each time."""
QUIET_S, LAST_QUIET_S = 0.1, 1.0
"""How long an offset stays as it is that has settled; before the rest is sent, longer: a busy service may come late to what a link
brought before it broke."""
PATIENCE_S: Final = 10.0
"""For a service that still receives from a link of which it has not heard that it broke."""
TAKEN_OVER: Final = (408, 423)
"""Answers to a request that another has taken over from, or that came too slowly: a client asks for the offset and goes on."""
MOST_TRIES: Final = 10
"""Of sending the rest: each of the links that broke may come in between once or more."""


def cut_links(subject: Subject) -> None:
    """A link that breaks at random bytes, again and again."""
    path, content = subject.new_file()
    address = subject.begun(path, len(content))
    stored, sent, cuts, pause_s = 0, 0, 0, FIRST_PAUSE_S
    while cuts < CUTS or (stored == 0 and pause_s <= PATIENCE_S):
        ends = random.randrange(stored, len(content))
        _sent_and_cut(subject, address, stored, content[stored:], ends - stored, pause_s)
        sent, cuts, pause_s = max(sent, ends), cuts + 1, 2 * pause_s
        stored = _kept(subject, address, stored, sent, QUIET_S)
    expect(stored > 0, f"of {cuts} chunks that were cut no byte was kept")
    _send_the_rest(subject, address, content, stored, sent)
    expect(not subject.is_missing(path), "the file came whole in the end, and is asked for again")


def _send_the_rest(subject: Subject, address: str, content: bytes, stored: int, sent: int) -> None:
    """From where the service is, and from there again where bytes of a link that broke came in between."""
    for _ in range(MOST_TRIES):
        stored = _kept(subject, address, stored, sent, LAST_QUIET_S)
        status = subject.patch(address, stored, content[stored:]).status_code
        if status == 204:
            return
        sent = len(content)  # of a request that another took over from
        if status not in TAKEN_OVER and (status != 409 or _kept(subject, address, stored, sent, QUIET_S) == stored):
            break
    expect(False, f"the rest, from {stored} on, was answered {status}")


def _kept(subject: Subject, address: str, before: int, sent: int, quiet_s: float) -> int:
    """The settled offset, which is neither less than before nor more than was sent."""
    stored = _settled_offset(subject, address, quiet_s)
    expect(before <= stored <= sent, f"after {sent} bytes were sent {stored} are stored, {before} were before")
    return stored


def twice_delivered(subject: Subject) -> None:
    """A chunk whose answer was lost comes once more."""
    path, content = subject.new_file()
    address, half = subject.begun(path, len(content)), len(content) // 2
    subject.patch(address, 0, content[:half])
    again = subject.patch(address, 0, content[:half])
    expect(again.status_code == 409, f"a chunk that came twice was answered {again.status_code}, not 409")
    subject.patch(address, half, content[half:])
    last = subject.patch(address, half, content[half:])
    expect(last.status_code in (204, 409), f"the last chunk, twice, was answered {last.status_code}")
    expect(not subject.is_missing(path), "the file is whole and is asked for again")


def at_once(subject: Subject) -> None:
    """Two clients continue one upload at the same time."""
    path, content = subject.new_file()
    address = subject.begun(path, len(content))
    with ThreadPoolExecutor(2) as pool:
        answers = [pool.submit(subject.patch, address, 0, content) for _ in range(2)]
    statuses = [answer.result().status_code for answer in answers if answer.exception() is None]
    expect(bool(statuses), "neither of two at once was answered")
    expect(all(status in (204, 408, 409, 423) for status in statuses), f"two at once were answered {statuses}")
    stored = _settled_offset(subject, address)
    expect(stored <= len(content), f"of {len(content)} bytes that came twice at once, {stored} are said to be there")
    if stored < len(content):
        subject.patch(address, stored, content[stored:])
    expect(not subject.is_missing(path), "the file came twice at once and is asked for again")


def flipped_byte(subject: Subject) -> None:
    """A file that differs by one bit from what was announced."""
    path, content = subject.new_file()
    wrong = bytearray(content)
    wrong[len(content) // 2] ^= 1
    address = subject.begun(path, len(content))
    answer = subject.patch(address, 0, bytes(wrong))
    expect(answer.status_code >= 400, f"a file with another SHA-256 was answered {answer.status_code}")
    expect(subject.is_missing(path), "a file with another SHA-256 was taken")
    renewed = subject.begun(path, len(content))
    expect(subject.patch(renewed, 0, content).status_code == 204, "the right file is not taken after the wrong one")
    expect(not subject.is_missing(path), "the right file after the wrong one is asked for again")


def finished_once_more(subject: Subject) -> None:
    """A file that has arrived is sent once more by a client that forgot."""
    path, content = subject.new_file()
    subject.patch(subject.begun(path, len(content)), 0, content)
    again = subject.create(path, len(content))
    expect(again.status_code in (201, 409), f"a file that is there was answered {again.status_code}")
    expect(not subject.is_missing(path), "a file that is there is asked for once more")


def _sent_and_cut(subject: Subject, address: str, offset: int, content: bytes, sent: int, pause_s: float) -> None:
    """The head of a PATCH with all of content, and only so many of its bytes; after a pause the link is gone."""
    parts = urlsplit(subject.url)
    path = urlsplit(address).path if "://" in address else f"{parts.path}{address}"
    head = {
        "Host": parts.netloc, "Tus-Resumable": VERSION, "Content-Type": CONTENT_TYPE, "Upload-Offset": str(offset),
        "Content-Length": str(len(content)), **subject.headers,
    }  # fmt: skip
    lines = [f"PATCH {path} HTTP/1.1", *(f"{name}: {value}" for name, value in head.items()), "", ""]
    secure = parts.scheme == "https"
    try:
        link = socket.create_connection((parts.hostname or "", parts.port or (443 if secure else 80)), timeout=PATIENCE_S)
        with ssl.create_default_context().wrap_socket(link, server_hostname=parts.hostname) if secure else link as open_link:
            open_link.sendall("\r\n".join(lines).encode() + content[:sent])
            time.sleep(pause_s)
    except OSError as error:
        raise ServiceError(f"{subject.url} does not answer: {error}") from error


def _settled_offset(subject: Subject, address: str, quiet_s: float = QUIET_S) -> int:
    """The offset when nothing has been received for so long."""
    ends = time.monotonic() + PATIENCE_S
    while subject.head(address).status_code == 423 and time.monotonic() < ends:
        time.sleep(0.1)
    stored = subject.offset(address)
    while time.monotonic() < ends:
        time.sleep(quiet_s)
        before, stored = stored, subject.offset(address)
        if stored == before:
            break
    return stored


DRILLS: Final = (
    Check("cut links", "a link that breaks at random bytes, again and again, costs no byte that was stored", cut_links),
    Check("twice", "a chunk that comes twice counts once", twice_delivered),
    Check("at once", "two clients at once leave one whole file", at_once),
    Check("flipped bit", "a file with another SHA-256 is refused, and the right one taken after it", flipped_byte),
    Check("forgotten", "a file that is there is not asked for once more", finished_once_more),
)
