"""Words for the types of kernels' arguments."""

from collections import namedtuple

import numpy as np
import pytest
from numba import typeof, types

from wayloom.config.kernel_types import types_of, words_of

Pair = namedtuple("Pair", ["one", "other"])
FIXED = np.zeros((2, 2), np.uint8)
FIXED.flags.writeable = False


@pytest.mark.parametrize(
    ("words", "arguments"),
    [
        ("f8 i8 b1 f4", (1.0, 1, True, np.float32(1.0))),
        ("u1:2 b1:1 i2:3", (np.zeros((2, 2), np.uint8), np.zeros(1, bool), np.zeros((1, 1, 1), np.int16))),
        ("f8:2F f8:3A u1:2R", (np.asfortranarray(np.zeros((3, 2))), np.zeros((4, 4, 4))[::2, :, ::2], FIXED)),
        ("(i8,i8) (f8:1,(i4:2,i8))", ((1, 1), (np.zeros(1), (np.zeros((1, 1), np.int32), 1)))),
        ("", ()),
    ],
)
def test_words_name_the_types_of_arguments_and_come_back(words: str, arguments: tuple[object, ...]) -> None:
    found = tuple(typeof(one) for one in arguments)
    assert words_of(found) == words
    assert types_of(words) == found


def test_a_named_tuple_is_known_by_its_name_only() -> None:
    pair = typeof(Pair(1.0, np.zeros(1)))
    assert types_of("pair f8", {"pair": pair}) == (pair, types.float64)
    with pytest.raises(ValueError, match="no word"):
        words_of((pair,))


@pytest.mark.parametrize("words", ["pair", "f8:", "f8:x", "(f8", "i8:2 f77"])
def test_what_is_no_word_is_named(words: str) -> None:
    with pytest.raises(ValueError, match="not a word for a type: "):
        types_of(words)
