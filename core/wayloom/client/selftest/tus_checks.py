"""The clauses of tus 1.0.0 that a server must keep: those of the core protocol, and of the extensions that it says it has."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from email.utils import parsedate_to_datetime
from typing import Final

from wayloom.client.selftest.subject import CONTENT_TYPE, UPLOADS, VERSION, Subject, checksum, expect

GONE: Final = (403, 404, 410)


@dataclass(frozen=True, slots=True)
class Check:
    """One thing that is asked: its name, what is asked in words, how it is tried, and the extension that it belongs to."""

    name: str
    asks: str
    run: Callable[[Subject], None]
    extension: str | None = None


def capabilities(subject: Subject) -> None:
    """OPTIONS without Tus-Resumable."""
    answer = subject.send("OPTIONS", UPLOADS)
    expect(answer.status_code in (200, 204), f"OPTIONS answered {answer.status_code}")
    versions = [version.strip() for version in answer.headers.get("tus-version", "").split(",")]
    expect(VERSION in versions, f"Tus-Version is {answer.headers.get('tus-version')!r}")


def other_versions(subject: Subject) -> None:
    """Another Tus-Resumable, and none."""
    path, content = subject.new_file()
    address = subject.begun(path, len(content))
    for version in ("0.2.2", ""):
        headers = {"Tus-Resumable": version, "Content-Type": CONTENT_TYPE, "Upload-Offset": "0"}
        answer = subject.send("PATCH", address, headers, content=content[:10])
        expect(answer.status_code == 412, f"Tus-Resumable {version!r} was answered {answer.status_code}, not 412")
        expect(VERSION in answer.headers.get("tus-version", ""), "412 came without Tus-Version")
    expect(subject.offset(address) == 0, "a chunk of another version was stored")


def stated_version(subject: Subject) -> None:
    """Tus-Resumable in answers."""
    path, content = subject.new_file()
    created = subject.create(path, len(content))
    address = created.headers.get("location", "")
    for name, answer in (("POST", created), ("HEAD", subject.head(address)), ("PATCH", subject.patch(address, 0, content[:10]))):
        stated = answer.headers.get("tus-resumable")
        expect(stated == VERSION, f"the answer to {name} has Tus-Resumable {stated!r}")


def creation(subject: Subject) -> None:
    """POST, then HEAD."""
    path, content = subject.new_file()
    address = subject.begun(path, len(content))
    answer = subject.head(address)
    expect(answer.headers.get("upload-offset") == "0", f"a new upload's offset is {answer.headers.get('upload-offset')!r}")
    expect(answer.headers.get("upload-length") == str(len(content)), "HEAD does not tell the length")
    expect("no-store" in answer.headers.get("cache-control", ""), "HEAD may be cached: Cache-Control lacks no-store")


def told_metadata(subject: Subject) -> None:
    """Upload-Metadata comes back."""
    path, content = subject.new_file()
    answer = subject.head(subject.begun(path, len(content)))
    expect(answer.headers.get("upload-metadata") == subject.metadata(path), "HEAD does not tell the metadata as it was given")


def bad_lengths(subject: Subject) -> None:
    """POST without a length, and with one that is none."""
    path, _ = subject.new_file()
    headers = {"Tus-Resumable": VERSION, "Upload-Metadata": subject.metadata(path)}
    for more in ({}, {"Upload-Length": "-1"}, {"Upload-Length": "many"}):
        answer = subject.send("POST", UPLOADS, headers | more)
        expect(400 <= answer.status_code < 500, f"a length of {more.get('Upload-Length')!r} was answered {answer.status_code}")


def continuation(subject: Subject) -> None:
    """Two chunks."""
    path, content = subject.new_file()
    address, half = subject.begun(path, len(content)), len(content) // 2
    for start, end in ((0, half), (half, len(content))):
        answer = subject.patch(address, start, content[start:end])
        expect(answer.status_code == 204, f"PATCH answered {answer.status_code}, not 204")
        expect(
            answer.headers.get("upload-offset") == str(end), f"Upload-Offset is {answer.headers.get('upload-offset')!r}, not {end}"
        )
    expect(not subject.is_missing(path), "the file is whole and is asked for again")


def wrong_offsets(subject: Subject) -> None:
    """Chunks that start elsewhere."""
    path, content = subject.new_file()
    address = subject.begun(path, len(content))
    subject.patch(address, 0, content[:1000])
    for start in (0, 999, 1001):
        answer = subject.patch(address, start, content[start : start + 10])
        expect(answer.status_code == 409, f"a chunk at {start} of 1000 stored bytes was answered {answer.status_code}, not 409")
    expect(subject.offset(address) == 1000, "a refused chunk was stored")


def wrong_content_type(subject: Subject) -> None:
    """PATCH of another media type."""
    path, content = subject.new_file()
    address = subject.begun(path, len(content))
    answer = subject.patch(address, 0, content[:10], **{"Content-Type": "application/octet-stream"})
    expect(answer.status_code == 415, f"another Content-Type was answered {answer.status_code}, not 415")
    expect(subject.offset(address) == 0, "a refused chunk was stored")


def too_much(subject: Subject) -> None:
    """More bytes than were announced."""
    path, content = subject.new_file()
    address = subject.begun(path, len(content))
    answer = subject.patch(address, 0, content + b"more")
    expect(400 <= answer.status_code < 500, f"more bytes than Upload-Length were answered {answer.status_code}")
    expect(subject.offset(address) <= len(content), "more bytes were stored than announced")


def unknown_uploads(subject: Subject) -> None:
    """An address that is none."""
    address = f"{UPLOADS}/{'0' * 32}"
    for name, answer in (("HEAD", subject.head(address)), ("PATCH", subject.patch(address, 0, b"x"))):
        expect(answer.status_code in GONE, f"{name} of an unknown upload was answered {answer.status_code}")
        expect("upload-offset" not in answer.headers, f"{name} of an unknown upload told an offset")


def overridden_method(subject: Subject) -> None:
    """POST with X-HTTP-Method-Override."""
    path, content = subject.new_file()
    address = subject.begun(path, len(content))
    headers = {"Tus-Resumable": VERSION, "Content-Type": CONTENT_TYPE, "Upload-Offset": "0", "X-HTTP-Method-Override": "PATCH"}
    answer = subject.send("POST", address, headers, content=content[:10])
    expect(answer.status_code == 204 and subject.offset(address) == 10, f"an overridden PATCH was answered {answer.status_code}")


def creation_with_upload(subject: Subject) -> None:
    """POST with the first bytes."""
    path, content = subject.new_file()
    answer = subject.create(path, len(content), content[:1000])
    expect(answer.status_code == 201, f"POST answered {answer.status_code}, not 201")
    expect(answer.headers.get("upload-offset") == "1000", f"Upload-Offset is {answer.headers.get('upload-offset')!r}, not 1000")
    expect(subject.offset(answer.headers["location"]) == 1000, "HEAD tells another offset")


def right_checksums(subject: Subject) -> None:
    """SHA-1 at least, as the protocol asks."""
    told = subject.send("OPTIONS", UPLOADS).headers.get("tus-checksum-algorithm", "")
    algorithms = [name.strip() for name in told.split(",")]
    expect("sha1" in algorithms, f"Tus-Checksum-Algorithm is {algorithms}: sha1 is asked of every server")
    path, content = subject.new_file()
    address = subject.begun(path, len(content))
    known = [name for name in algorithms if name in hashlib.algorithms_available and not name.startswith("shake_")]
    for number, algorithm in enumerate(known):
        start = 100 * number
        chunk = content[start : start + 100]
        answer = subject.patch(address, start, chunk, **{"Upload-Checksum": checksum(chunk, algorithm)})
        expect(answer.status_code == 204, f"a chunk with the right {algorithm} was answered {answer.status_code}")


def wrong_checksums(subject: Subject) -> None:
    """Sums that are wrong, unknown or none."""
    path, content = subject.new_file()
    address = subject.begun(path, len(content))
    sums = ((checksum(content[1:101]), 460), ("crc0 AAAA", 400), ("sha1 ?", 400))
    for given, status in sums:
        answer = subject.patch(address, 0, content[:100], **{"Upload-Checksum": given})
        expect(answer.status_code == status, f"Upload-Checksum {given[:20]!r} was answered {answer.status_code}, not {status}")
        expect(subject.offset(address) == 0, "a chunk whose sum is wrong was stored")


def expiration(subject: Subject) -> None:
    """Upload-Expires."""
    path, content = subject.new_file()
    address = subject.begun(path, len(content))
    told = subject.patch(address, 0, content[:10]).headers.get("upload-expires", "")
    try:
        parsedate_to_datetime(told)
    except ValueError:
        expect(False, f"Upload-Expires {told!r} is no HTTP date")


def termination(subject: Subject) -> None:
    """DELETE."""
    path, content = subject.new_file()
    address = subject.begun(path, len(content))
    answer = subject.send("DELETE", address, {"Tus-Resumable": VERSION})
    expect(answer.status_code == 204, f"DELETE answered {answer.status_code}, not 204")
    expect(subject.head(address).status_code in GONE, "an upload that was given up is still there")
    expect(subject.is_missing(path), "a file whose upload was given up is not asked for any more")


CHECKS: Final = (
    Check("capabilities", "OPTIONS tells versions, and asks for none", capabilities),
    Check("versions", "another version is refused with 412 and the right one", other_versions),
    Check("stated version", "every answer says Tus-Resumable", stated_version),
    Check("offsets", "a new upload has offset 0, length and no cached HEAD", creation),
    Check("metadata", "HEAD tells the metadata as it was given", told_metadata),
    Check("bad lengths", "no upload begins without a length", bad_lengths),
    Check("chunks", "PATCH at the offset is stored, and told", continuation),
    Check("wrong offsets", "PATCH elsewhere is 409 and changes nothing", wrong_offsets),
    Check("content type", "PATCH of another type is 415 and changes nothing", wrong_content_type),
    Check("too much", "no byte beyond the length is stored", too_much),
    Check("unknown uploads", "404, 410 or 403, without an offset", unknown_uploads),
    Check("method override", "POST stands for PATCH where the header says so", overridden_method),
    Check("first bytes", "POST takes the first bytes", creation_with_upload, "creation-with-upload"),
    Check("right sums", "a chunk with its checksum is stored; sha1 is known", right_checksums, "checksum"),
    Check("wrong sums", "460, or 400 for an unknown one, and nothing is stored", wrong_checksums, "checksum"),
    Check("expiry", "Upload-Expires is an HTTP date", expiration, "expiration"),
    Check("termination", "DELETE takes the upload away", termination, "termination"),
)
