"""Registration of a drive of very many files beside other requests."""

import gc
import json
import threading

import httpx2

from service_kit.running import ApiAlone
from wayloom_services.collector import paused_collector

FILES = 30_000


def manifest(name: str) -> bytes:
    files = [{"path": f"log/{i:06}.png", "size": i, "sha256": f"{i:064x}"} for i in range(FILES)]
    return json.dumps({"name": name, "files": files}).encode()


def test_a_drive_of_very_many_files_is_registered_whole(api_process: ApiAlone, http: httpx2.Client) -> None:
    answers, over = 0, threading.Event()

    def ask() -> None:
        nonlocal answers
        with httpx2.Client(base_url=api_process.url, timeout=30.0, trust_env=False) as other:
            while not over.is_set():
                answers += other.get("/healthz").status_code == 200

    asking = threading.Thread(target=ask)
    asking.start()
    answer = http.post("/v1/drives", content=manifest("very many"), headers={"Content-Type": "application/json"})
    over.set()
    asking.join()
    missing = answer.json()["missing"]
    assert (answer.status_code, len(missing)) == (201, FILES)
    assert [file["size"] for file in missing] == list(range(FILES))
    assert answers > 10  # nobody waits for the whole of it


def test_nothing_is_collected_while_any_thread_works_on_many_objects() -> None:
    with paused_collector():
        with paused_collector():
            assert not gc.isenabled()
        assert not gc.isenabled()
    assert gc.isenabled()
