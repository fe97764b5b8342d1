"""One API process a file of tests: what one of them leaves behind disturbs none of another file."""

from collections.abc import Iterator

import pytest

from service_kit.running import ApiAlone


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ApiAlone]:
    server = ApiAlone(tmp_path_factory.mktemp("server") / "data")
    yield server
    server.close()
