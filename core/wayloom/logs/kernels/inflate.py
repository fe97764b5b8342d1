"""Deflate decompression (RFC 1951) for images: Huffman tables from which one look-up takes two literals.

A code is five arrays: `fast` (2^bits,) uint16 = symbol << 4 | length by the next bits of the stream, 0 where the code is longer or
unknown; `first`, `amount`, `offset` (16,) by length and `symbols`, for those (the canonical search). Bits wait in a uint64, lowest
first; `state` (3,) uint64 holds them between blocks: bits, how many, position in the data.
"""

from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit

OPTIONS: Final[dict[str, Any]] = {"cache": True, "error_model": "numpy", "nogil": True, "_nrt": False}
bare = njit(**OPTIONS)
inlined = njit(**OPTIONS, forceinline=True)
u8, u32, u64 = np.uint8, np.uint32, np.uint64
ONE = u64(1)
PADDING = 32
"""Bytes that data and output hold beyond their end."""
LITERAL_BITS, DISTANCE_BITS, LENGTH_BITS = 12, 9, 7
STORED, FIXED, DYNAMIC = 0, 1, 2
LITERALS, END_OF_BLOCK = 256, u64(256)
LENGTH_EXTRA = np.concatenate([np.zeros(8), np.repeat(np.arange(1, 6), 4), [0]]).astype(np.uint64)
DISTANCE_EXTRA = np.concatenate([np.zeros(2), np.repeat(np.arange(14), 2)]).astype(np.uint64)
LENGTH_BASE = np.minimum(3 + np.cumsum(ONE << LENGTH_EXTRA) - (ONE << LENGTH_EXTRA), u64(258))
DISTANCE_BASE = 1 + np.cumsum(ONE << DISTANCE_EXTRA) - (ONE << DISTANCE_EXTRA)
LENGTHS_ORDER = np.array([16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15], np.int64)
"""RFC 1951, 3.2.5 and 3.2.7."""


class Code(NamedTuple):
    """A prefix code, see above."""

    fast: np.ndarray
    first: np.ndarray
    amount: np.ndarray
    offset: np.ndarray
    symbols: np.ndarray


def empty_code(bits: int, symbols: int) -> Code:
    """Room for a code of so many symbols, `bits` of which are looked up at once."""
    first, count, offset = np.zeros((3, 16), np.int64)
    return Code(np.zeros(1 << bits, np.uint16), first, count, offset, np.zeros(symbols, np.int64))


@inlined
def word(data, at):  # type: ignore[no-untyped-def]
    """Eight bytes of data (n,) uint8 at `at`, the first one lowest."""
    low = u64(data[at]) | u64(data[at + ONE]) << u64(8) | u64(data[at + u64(2)]) << u64(16) | u64(data[at + u64(3)]) << u64(24)
    high = u64(data[at + u64(4)]) | u64(data[at + u64(5)]) << u64(8) | u64(data[at + u64(6)]) << u64(16)
    return low | (high | u64(data[at + u64(7)]) << u64(24)) << u64(32)


@inlined
def fill(data, state):  # type: ignore[no-untyped-def]
    """Let at least 56 bits wait."""
    state[0] |= word(data, state[2]) << state[1]
    state[2] += (u64(63) - state[1]) >> u64(3)
    state[1] |= u64(56)


@bare
def take(data, state, bits):  # type: ignore[no-untyped-def]
    """The next `bits` bits of the stream, at most 32."""
    if state[1] < bits:
        fill(data, state)
    value = state[0] & ((ONE << bits) - ONE)
    state[0] >>= bits
    state[1] -= bits
    return value


@bare
def make_code(lengths, code):  # type: ignore[no-untyped-def]
    """Fill code from the lengths (n,) uint8 of its symbols, 0 for unused ones (RFC 1951, 3.2.2); False where they are no code."""
    fast, first, count, offset, symbols = code.fast, code.first, code.amount, code.offset, code.symbols
    count[:] = 0
    for length in lengths:
        count[length] += 1
    count[0], number, place = 0, 0, 0
    for length in range(1, 16):
        number = (number + count[length - 1]) << 1
        first[length], offset[length] = number, place
        place += count[length]
        if number + count[length] > 1 << length:
            return False
    fast[:] = 0
    count[:] = 0
    for symbol in range(lengths.shape[0]):
        length = lengths[symbol]
        if length == 0:
            continue
        number = first[length] + count[length]
        symbols[offset[length] + count[length]] = symbol
        count[length] += 1
        if 1 << length <= fast.shape[0]:
            turned = 0
            for bit in range(length):
                turned = turned << 1 | number >> bit & 1
            for at in range(turned, fast.shape[0], 1 << length):
                fast[at] = symbol << 4 | length
    return True


@bare
def search(waiting, code):  # type: ignore[no-untyped-def]
    """symbol << 4 | length of the next code of any length, 0 where it is none."""
    number = np.int64(0)
    for length in range(1, 16):
        number |= np.int64(waiting >> u64(length - 1) & ONE)
        place = number - code.first[length]
        if place < code.amount[length]:
            return u64(code.symbols[code.offset[length] + place] << 4 | length)
        number <<= 1
    return u64(0)


@inlined
def next_code(waiting, code):  # type: ignore[no-untyped-def]
    """symbol << 4 | length of the next code, 0 where it is none."""
    found = u64(code.fast[waiting & u64(code.fast.shape[0] - 1)])
    return found if found != u64(0) else search(waiting, code)


@bare
def read_lengths(data, state, end, code_lengths, lengths):  # type: ignore[no-untyped-def]
    """The lengths of a dynamic block's codes (RFC 1951, 3.2.7) into lengths (320,) uint8. Returns how many literals and distances
    there are, 0 literals for nonsense; code_lengths serves as the code of the lengths."""
    literals, distances = np.int64(take(data, state, u64(5))) + 257, np.int64(take(data, state, u64(5))) + 1
    used = np.int64(take(data, state, u64(4))) + 4
    lengths[:19] = u8(0)
    for i in range(used):
        lengths[LENGTHS_ORDER[i]] = u8(take(data, state, u64(3)))
    if not make_code(lengths[:19], code_lengths):
        return 0, 0
    i, total = 0, literals + distances
    while i < total:
        if state[2] > end:
            return 0, 0
        fill(data, state)
        found = next_code(state[0], code_lengths)
        if found == u64(0):
            return 0, 0
        take(data, state, found & u64(15))
        symbol, repeat, value = found >> u64(4), np.int64(1), u8(0)
        if symbol < u64(16):
            value = u8(symbol)
        elif symbol == u64(16):
            if i == 0:
                return 0, 0
            repeat, value = 3 + np.int64(take(data, state, u64(2))), lengths[i - 1]
        elif symbol == u64(17):
            repeat = 3 + np.int64(take(data, state, u64(3)))
        else:
            repeat = 11 + np.int64(take(data, state, u64(7)))
        if i + repeat > total:
            return 0, 0
        lengths[i : i + repeat] = value
        i += int(repeat)
    return literals, distances


@bare
def pair_up(fast, pairs):  # type: ignore[no-untyped-def]
    """Fill pairs (2^12,) uint32 = bits | number << 8 | first << 16 | second << 24: the one or two literals that the next bits hold,
    0 where they begin with something else."""
    for at in range(pairs.shape[0]):
        first = fast[at]
        bits, symbol = first & 15, first >> 4
        pairs[at] = 0
        if first == 0 or symbol >= LITERALS:
            continue
        pairs[at] = u32(bits) | u32(1) << u32(8) | u32(symbol) << u32(16)
        second = fast[at >> bits]
        more, symbol_2 = second & 15, second >> 4
        if second != 0 and bits + more <= LITERAL_BITS and symbol_2 < LITERALS:
            pairs[at] = u32(bits + more) | u32(2) << u32(8) | u32(symbol) << u32(16) | u32(symbol_2) << u32(24)


@bare
def decode_block(data, state, end, literals, distances, pairs, out, at):  # type: ignore[no-untyped-def]
    """The symbols of one block into out (n,) uint8 from `at` on. Returns where it ends; more than n where it is nonsense."""
    waiting, number, position = state[0], state[1], state[2]
    room, nonsense, mask = u64(out.shape[0] - PADDING), u64(out.shape[0] + 1), u64(pairs.shape[0] - 1)
    while True:
        if position > end or at > room:
            return nonsense
        waiting |= word(data, position) << number
        position += (u64(63) - number) >> u64(3)
        number |= u64(56)
        found, k = u64(pairs[waiting & mask]), 0
        while found != u64(0) and k < 4:  # 4 times 12 bits are there
            bits = found & u64(255)
            out[at], out[at + ONE] = u8(found >> u64(16)), u8(found >> u64(24))
            at += found >> u64(8) & u64(255)
            waiting >>= bits
            number -= bits
            found, k = u64(pairs[waiting & mask]), k + 1
        if k > 0:
            continue
        found = next_code(waiting, literals)
        bits, symbol = found & u64(15), found >> u64(4)
        if found == u64(0) or symbol > u64(285):
            return nonsense
        waiting >>= bits
        number -= bits
        if symbol < END_OF_BLOCK:
            out[at] = u8(symbol)
            at += ONE
            continue
        if symbol == END_OF_BLOCK:
            state[0], state[1], state[2] = waiting, number, position
            return at
        bits = LENGTH_EXTRA[symbol - u64(257)]
        length = LENGTH_BASE[symbol - u64(257)] + (waiting & ((ONE << bits) - ONE))
        waiting >>= bits
        number -= bits
        found = next_code(waiting, distances)  # at most 48 bits since the last filling
        bits, symbol = found & u64(15), found >> u64(4)
        if found == u64(0) or symbol > u64(29):
            return nonsense
        waiting >>= bits
        number -= bits
        bits = DISTANCE_EXTRA[symbol]
        distance = DISTANCE_BASE[symbol] + (waiting & ((ONE << bits) - ONE))
        waiting >>= bits
        number -= bits
        if distance > at or length > room - at:
            return nonsense
        for _ in range(length):
            out[at] = out[at - distance]
            at += ONE


@bare
def copy_stored(data, state, end, out, at):  # type: ignore[no-untyped-def]
    """A block that is not compressed, as decode_block."""
    position = state[2] - (state[1] >> u64(3))
    length = u64(data[position]) | u64(data[position + ONE]) << u64(8)
    position += u64(4)
    if position + length > end or at + length > u64(out.shape[0] - PADDING):
        return u64(out.shape[0] + 1)
    for k in range(length):
        out[at + u64(k)] = data[position + u64(k)]
    state[0], state[1], state[2] = u64(0), u64(0), position + length
    return at + length


@bare
def inflate(data, out, state, lengths, code_lengths, literals, distances, pairs):  # type: ignore[no-untyped-def]
    """Inflate a zlib stream (RFC 1950; its check sum is not looked at), 2 bytes of head left out here.

    data (n + PADDING,) and out (m + PADDING,) uint8; state (3,) uint64, lengths (320,) uint8, the codes and pairs (2^12,) uint32
    are working space. Returns how many bytes came out, -1 for a stream that is not whole, holds more than m bytes or a fault.
    """
    end, at, last = u64(data.shape[0] - PADDING + 8), u64(0), False
    state[0], state[1], state[2] = u64(0), u64(0), u64(2)
    while not last:
        if state[2] > end:
            return -1
        last, kind = take(data, state, ONE) == ONE, take(data, state, u64(2))
        if kind == u64(STORED):
            at = copy_stored(data, state, end, out, at)
        else:
            many, few = 288, 30
            if kind == u64(FIXED):
                lengths[:144], lengths[144:256], lengths[256:280], lengths[280:288] = u8(8), u8(9), u8(7), u8(8)
                lengths[288:318] = u8(5)
            else:
                many, few = read_lengths(data, state, end, code_lengths, lengths)
            if kind > u64(DYNAMIC) or many == 0 or not make_code(lengths[:many], literals):
                return -1
            if not make_code(lengths[many : many + few], distances):
                return -1
            pair_up(literals.fast, pairs)
            at = decode_block(data, state, end, literals, distances, pairs, out, at)
        if at > u64(out.shape[0]):
            return -1
    return np.int64(at) if state[2] - (state[1] >> u64(3)) <= u64(data.shape[0] - PADDING) else -1
