"""One API process for the tests that leave it as it is."""

from collections.abc import Iterator
from pathlib import Path

import httpx2
import pytest

from service_kit.running import ApiAlone


@pytest.fixture(scope="session")
def api_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ApiAlone]:
    alone = ApiAlone(tmp_path_factory.mktemp("api") / "data", WAYLOOM_MAX_FILE_BYTES=str(64 << 20))
    yield alone
    alone.close()


@pytest.fixture
def http(api_process: ApiAlone) -> Iterator[httpx2.Client]:
    with httpx2.Client(base_url=api_process.url, timeout=30.0, trust_env=False) as client:
        yield client


@pytest.fixture
def drive_folder(api_process: ApiAlone) -> Path:
    return api_process.data / "drives"
