"""Static files, compressed once and beside the event loop."""

import asyncio
import gzip
from pathlib import Path
from threading import current_thread, main_thread

import httpx2
import pytest

from wayloom_services import assets
from wayloom_services.assets import Assets


def test_a_file_that_many_ask_for_at_once_is_compressed_once_and_not_by_the_thread_that_serves_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = b"let all = 1;\n" * 1000
    (tmp_path / "large.js").write_bytes(text)
    packed_by = []
    compress = gzip.compress

    def noted(*arguments: object, **named: object) -> bytes:
        packed_by.append(current_thread())
        return compress(*arguments, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(assets.gzip, "compress", noted)

    async def answers() -> list[httpx2.Response]:
        transport = httpx2.ASGITransport(app=Assets(tmp_path))
        async with httpx2.AsyncClient(transport=transport, base_url="http://here") as client:
            return await asyncio.gather(*(client.get("/large.js") for _ in range(5)))

    for answer in asyncio.run(answers()):
        assert answer.headers["content-encoding"] == "gzip"
        assert answer.content == text
    assert len(packed_by) == 1
    assert packed_by[0] is not main_thread()
