"""TOML text of single values: what tomllib, which only reads, has no writer for."""

from collections.abc import Sequence
from pathlib import PurePath


def toml_text(value: object) -> str:
    """A value as it stands right of the equals sign. Floats keep all their digits.

    value : bool, int, float, text, path, or a list or tuple of these. Raises TypeError for anything else (TOML has no null).
    """
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str | PurePath):
        return f'"{"".join(_escaped(character) for character in str(value))}"'
    if isinstance(value, Sequence):
        return f"[{', '.join(toml_text(item) for item in value)}]"
    raise TypeError(f"TOML cannot hold {value!r}")


def _escaped(character: str) -> str:
    return character if character.isprintable() and character not in '"\\' else f"\\U{ord(character):08X}"
