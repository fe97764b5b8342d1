"""tus as a client writes it by hand."""

import base64
import hashlib
import zlib
from typing import Any

import httpx2

V = {"Tus-Resumable": "1.0.0"}
CHUNK = {**V, "Content-Type": "application/offset+octet-stream"}


def b64(content: bytes | str) -> str:
    return base64.b64encode(content.encode() if isinstance(content, str) else content).decode()


def manifest(name: str, **contents: bytes) -> dict[str, Any]:
    """Of a drive whose files are `log/NAME`."""
    sums = {path: hashlib.sha256(data).hexdigest() for path, data in contents.items()}
    return {"name": name, "files": [{"path": f"log/{path}", "size": len(contents[path]), "sha256": sums[path]} for path in sums]}


def register(http: httpx2.Client, name: str, **contents: bytes) -> str:
    """Announce a drive whose files are `log/NAME`. Returns its id."""
    answer = http.post("/v1/drives", json=manifest(name, **contents))
    assert answer.status_code in (200, 201), answer.text
    return str(answer.json()["id"])


def metadata(drive: str, path: str) -> str:
    return f"drive {b64(drive)},path {b64(path)}"


def create(
    http: httpx2.Client, drive: str, path: str, length: int, content: bytes | None = None, **headers: str
) -> httpx2.Response:
    """Start an upload, with the first bytes where there are some."""
    sent = {**(V if content is None else CHUNK), "Upload-Length": str(length), "Upload-Metadata": metadata(drive, path), **headers}
    return http.post("/v1/uploads", headers=sent, content=content)


def patch(http: httpx2.Client, address: str, offset: int, content: Any, **headers: str) -> httpx2.Response:
    return http.patch(address, headers={**CHUNK, "Upload-Offset": str(offset), **headers}, content=content)


def head(http: httpx2.Client, address: str) -> httpx2.Response:
    return http.head(address, headers=V)


def offset(http: httpx2.Client, address: str) -> int:
    return int(head(http, address).headers["Upload-Offset"])


def checksum(content: bytes, algorithm: str = "sha256") -> dict[str, str]:
    return {"Upload-Checksum": f"{algorithm} {b64(hashlib.new(algorithm, content).digest())}"}


def pieces(content: bytes, size: int) -> dict[str, str]:
    sums = b"".join(zlib.crc32(content[start : start + size]).to_bytes(4) for start in range(0, len(content), size))
    return {"Upload-Pieces": f"crc32 {size} {b64(sums)}"}


def received(url: str) -> float:
    """Bytes of drives that a server has taken, by its own count: in an object store they wait in its memory."""
    text = httpx2.get(f"{url}/metrics", timeout=30.0, trust_env=False).text
    return float(text.partition("\nwayloom_upload_bytes_total ")[2].split()[0])
