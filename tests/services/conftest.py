"""One API process for the tests that leave it as it is, and one browser a module."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx2
import pytest
from map_pages import Open, opening

from service_kit import filled_service
from service_kit.browsers import answering, chromium
from service_kit.looked_at import LookedAt
from service_kit.running import ApiAlone


@pytest.fixture(scope="session")
def api_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ApiAlone]:
    alone = ApiAlone(tmp_path_factory.mktemp("api") / "data", WAYLOOM_MAX_FILE_BYTES=str(64 << 20))
    yield alone
    alone.close()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as launched:
        yield launched


@pytest.fixture
def opened(browser: Any, shown: LookedAt) -> Iterator[Open]:
    """Opens the map of the module's `shown` with what is behind `#`; at the end no page may have complained."""
    with opening(browser, shown) as open_:
        yield open_


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    """An empty page, closed whatever the test finds."""
    opened = browser.new_page()
    yield opened
    opened.close()


@pytest.fixture
def filled(tmp_path: Path) -> Iterator[filled_service.Filled]:
    """A service of the test's own with something on every page."""
    alone, ids = filled_service.filled(tmp_path / "data")
    with closing(alone):
        answering(alone.url)
        yield alone, ids


@pytest.fixture
def http(api_process: ApiAlone) -> Iterator[httpx2.Client]:
    with httpx2.Client(base_url=api_process.url, timeout=30.0, trust_env=False) as client:
        yield client


@pytest.fixture
def drive_folder(api_process: ApiAlone) -> Path:
    return api_process.data / "drives"
