"""An object store that is away: uploads are told to come again, and go on where they were when it is back."""

import os
from pathlib import Path

import httpx2

from service_kit import tus
from service_kit.links import Gate
from service_kit.object_store import ObjectStoreServer, arrived
from service_kit.running import ApiAlone, until

MIB = 1 << 20


def test_an_upload_waits_for_an_object_store_that_is_away_and_goes_on(tmp_path: Path, object_store: ObjectStoreServer) -> None:
    content, gate = os.urandom(6 * MIB), Gate(object_store.variables["AWS_ENDPOINT"])
    alone = ApiAlone(tmp_path / "data", object_store, AWS_ENDPOINT=gate.url)
    try:
        with httpx2.Client(base_url=alone.url, timeout=60.0, trust_env=False) as http:
            until(lambda: http.get("/healthz").status_code == 200)
            drive = tus.register(http, "away", a=content)
            address = str(tus.create(http, drive, "log/a", len(content)).headers["Location"])
            assert tus.patch(http, address, 0, content[: 5 * MIB]).status_code == 204
            gate.shut()
            refused = tus.patch(http, address, 5 * MIB, content[5 * MIB :])
            assert (refused.status_code, refused.json()["code"], refused.headers["Retry-After"]) == (503, "away", "5")
            ready = http.get("/readyz")
            assert (ready.status_code, ready.json()["checks"]["objects"] == "ok") == (503, False)
            gate.open()
            assert tus.offset(http, address) == 5 * MIB
            assert tus.patch(http, address, 5 * MIB, content[5 * MIB :]).status_code == 204
        assert arrived(alone, drive, "log/a") == content
    finally:
        alone.close()
        gate.close()
