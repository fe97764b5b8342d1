"""Types of kernels' arguments in words, as lists of kernels that are compiled ahead name them.

A word is a number's type as numpy writes it (`f8`), an array's with its dimensions (`u1:2`), a tuple's (`(f8:2,i8)`), or the name
of a type that the reader knows. An array lies in C's order and may be written, unless F or A (any order) or R (read-only) follows.
"""

from collections.abc import Mapping
from typing import Any, Final, Literal

NONE_KNOWN: Final[Mapping[str, Any]] = {}


def types_of(words: str, known: Mapping[str, Any] = NONE_KNOWN) -> tuple[Any, ...]:
    """numba's types of arguments, from their words with blanks between them.

    known : numba's types by their names
    Raises ValueError for what is no word.
    """
    return tuple(_type(word, known) for word in words.split())


def words_of(types: tuple[Any, ...]) -> str:
    """The words of numba's types, which `types_of` gives back. Raises ValueError for a type that has none, as a named tuple."""
    words = " ".join(_word(one) for one in types)
    if types_of(words) != types:
        raise ValueError(f"no words for {types}")
    return words


def _type(word: str, known: Mapping[str, Any]) -> Any:
    import numpy as np
    from numba import from_dtype
    from numba.core import types

    if word in known:
        return known[word]
    if word.startswith("(") and word.endswith(")"):
        return types.Tuple([_type(part, known) for part in _parts(word[1:-1])])
    dtype, array, shape = word.partition(":")
    try:
        number = from_dtype(np.dtype(dtype))
        if not array:
            return number
        order: Literal["C", "F", "A"] = "F" if "F" in shape else "A" if "A" in shape else "C"
        return types.Array(number, int(shape[:1]), order, readonly="R" in shape)
    except (TypeError, ValueError) as error:
        raise ValueError(f"not a word for a type: {word}") from error


def _parts(text: str) -> list[str]:
    """What stands between the commas that are in no parentheses."""
    parts, depth = [""], 0
    for letter in text:
        depth += (letter == "(") - (letter == ")")
        if letter == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += letter
    return parts


def _word(one: Any) -> str:
    from numba.core.types import Array, Boolean, Number, Tuple, UniTuple
    from numba.np.numpy_support import as_dtype

    if isinstance(one, Tuple | UniTuple):
        return f"({','.join(_word(part) for part in one.types)})"
    if isinstance(one, Array):
        order = "" if one.layout == "C" else one.layout
        return f"{_word(one.dtype)}:{one.ndim}{order}{'' if one.mutable else 'R'}"
    if isinstance(one, Number | Boolean):
        return str(as_dtype(one).str[1:])
    raise ValueError(f"no word for {one}")
