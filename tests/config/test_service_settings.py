"""The service's settings."""

import tempfile
from pathlib import Path

from wayloom.config.service import LONGEST_SOCKET_PATH, load_service_settings


def test_the_brokers_socket_lies_in_the_data_folder():
    assert load_service_settings(data_dir=Path("/srv/wayloom")).broker_socket == Path("/srv/wayloom/valkey.sock")


def test_a_deep_data_folder_still_has_a_socket_that_the_system_takes():
    deep = Path("/srv") / ("a" * 120) / "data"
    socket = load_service_settings(data_dir=deep).broker_socket
    assert len(str(socket)) <= LONGEST_SOCKET_PATH
    assert socket.is_relative_to(tempfile.gettempdir())
    assert socket != load_service_settings(data_dir=deep.with_name("other")).broker_socket
