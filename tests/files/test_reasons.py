"""Codes of refusals: one table, which code and documents agree with."""

import re
from pathlib import Path

from wayloom.errors import CalibrationError, ConfigError, InputError, LogError, MissingExtraError, ModelError, UnknownFormatError
from wayloom.files.reasons import REASONS

ROOT = Path(__file__).parents[2]
KINDS = (InputError, LogError, CalibrationError, ModelError, ConfigError, MissingExtraError, UnknownFormatError)
DEFAULTS = {error.default_reason for error in KINDS}


def used() -> set[str]:
    texts = [file.read_text() for room in ("core", "workers", "services") for file in (ROOT / room).rglob("*.py")]
    found = {code for text in texts for code in re.findall(r'reason="([^"]+)"', text)}
    helper = (ROOT / "core/wayloom/files/text_files.py").read_text()
    return found | set(re.findall(r'"(file\.[a-z_]+)"', helper))


def test_every_code_that_is_given_is_in_the_table_and_every_one_there_is_given() -> None:
    assert used() | DEFAULTS == set(REASONS)


def test_the_documents_list_every_code_with_its_meaning() -> None:
    text = (ROOT / "docs/formats.md").read_text()
    assert all(f"| `{code}` | {meaning} |" in text for code, meaning in REASONS.items())


def test_an_error_without_a_code_of_its_own_has_its_kinds() -> None:
    assert LogError("x").reason == "log.invalid"
    assert CalibrationError("x", reason="file.missing").reason == "file.missing"
