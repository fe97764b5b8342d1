"""The service's settings."""

import tempfile
from pathlib import Path

from wayloom.config.service import LONGEST_SOCKET_PATH, ServiceSettings


def test_the_brokers_socket_lies_in_the_data_folder():
    assert ServiceSettings(data_dir=Path("/srv/wayloom")).broker_socket == Path("/srv/wayloom/valkey.sock")


def test_a_deep_data_folder_still_has_a_socket_that_the_system_takes():
    deep = Path("/srv") / ("a" * 120) / "data"
    socket = ServiceSettings(data_dir=deep).broker_socket
    assert len(str(socket)) <= LONGEST_SOCKET_PATH
    assert socket.is_relative_to(tempfile.gettempdir())
    assert socket != ServiceSettings(data_dir=deep.with_name("other")).broker_socket


def test_the_default_data_folder_does_not_move_with_the_working_folder():
    assert ServiceSettings().data_dir.is_absolute()
