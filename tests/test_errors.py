"""Messages of bad input are one line, whatever the names in them are."""

import pytest

from wayloom.errors import LogError


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("/cam\n\nleft", r"/cam\n\nleft"),
        ("/cam\u2028left", r"/cam\u2028left"),
        ("/cam\x1b[31m", r"/cam\x1b[31m"),
        ("/cam\u202eleft", r"/cam\u202eleft"),
        ("/Straße 7\u00a0m", "/Straße 7\u00a0m"),
        ("/caf\udce9", "/caf\udce9"),
    ],
)
def test_characters_that_break_lines_or_steer_terminals_are_escapes_and_others_stay(name: str, shown: str) -> None:
    error = LogError(f"it holds {name}", file="drive.mcap", record=name, remedy=f"look at {name}")
    assert str(error) == f"drive.mcap, {shown}: it holds {shown}; look at {shown}"
    assert error.record == name
