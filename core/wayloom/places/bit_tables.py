"""Hash tables of binary descriptors: locality-sensitive hashing by sampled bits, with probes beside the key.

Sampled bits are the family of Indyk and Motwani (1998) for the Hamming distance; the probes, all keys that differ in one bit, are
those of Lv et al. (2007). Nothing is trained, so what a table answers depends on what it holds and on nothing else. An entry is
a key of KEY_BITS bits and an owner; an owner has a key once.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.places.kernels.hashing import add_votes, count_entries, sampled_keys

Bits = NDArray[np.uint8]
TABLES: Final = 2
KEY_BITS: Final = 28
DESCRIPTOR_BITS: Final = 256
POSITIONS: Final = np.array([[(9 * s + 5 * t) % DESCRIPTOR_BITS for s in range(KEY_BITS)] for t in range(TABLES)])
"""(T, S): bits of the descriptor that make the keys, apart from each other and spread over all of them."""
FLIPS: Final = np.array([0, *(1 << s for s in range(KEY_BITS))], np.uint32)
"""The key itself, and every one that differs in one bit."""
FULL_WEIGHT: Final = 1 << 12
"""Votes of a descriptor that one entry alone has; they are shared by the entries where there are more."""
COMMON: Final = 256
"""A descriptor with more entries than that is too common to vote."""
BYTES_AN_ENTRY: Final = 12
"""Key, owner, and its share of the buckets' heads, at most."""


@dataclass(frozen=True, slots=True)
class Entries:
    """keys (E,) uint32, owners (E,) int32; increasing by key."""

    keys: NDArray[np.uint32]
    owners: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.keys)


class BitTables:
    """Entries of TABLES tables, with the heads of their buckets."""

    def __init__(self) -> None:
        self.tables = [Entries(np.zeros(0, np.uint32), np.zeros(0, np.int32)) for _ in range(TABLES)]
        self.heads = [_head(table) for table in self.tables]

    def replace(self, gone: NDArray[np.bool_], bits: Bits, owners: NDArray[np.int32]) -> None:
        """Drop the entries of the owners that are marked in gone (N,), then add descriptors bits (n, 32) of owners (n,)."""
        keys = keys_of(bits)
        for t, table in enumerate(self.tables):
            kept = ~gone[table.owners]
            self.tables[t] = _merged(Entries(table.keys[kept], table.owners[kept]), _sorted(keys[t], owners))
        self.heads = [_head(table) for table in self.tables]

    def votes(self, bits: Bits, owners: int) -> NDArray[np.int64]:
        """(owners,) votes for each owner of the descriptors bits (n, 32): rare ones count more."""
        votes = np.zeros(owners, np.int64)
        for keys, table, (head, shift) in zip(keys_of(bits), self.tables, self.heads, strict=True):
            counts = np.zeros(len(keys), np.int64)
            count_entries(head, table.keys, shift, keys, FLIPS, counts)
            weights = np.where((counts > 0) & (counts <= COMMON), FULL_WEIGHT // np.maximum(counts, 1), 0)
            add_votes(head, table.keys, table.owners, shift, keys, FLIPS, weights, votes)
        return votes

    @property
    def nbytes(self) -> int:
        """Memory of keys, owners and heads."""
        return sum(t.keys.nbytes + t.owners.nbytes + head.nbytes for t, (head, _) in zip(self.tables, self.heads, strict=True))


def keys_of(bits: Bits) -> NDArray[np.uint32]:
    """(T, n) uint32 keys of descriptors (n, 32)."""
    out = np.empty((TABLES, len(bits)), np.uint32)
    sampled_keys(np.ascontiguousarray(bits), POSITIONS, out)
    return out


def _sorted(keys: NDArray[np.uint32], owners: NDArray[np.int32]) -> Entries:
    """The entries of these keys and owners, each once."""
    both = np.unique((keys.astype(np.uint64) << np.uint64(32)) | owners.astype(np.uint64))
    return Entries((both >> np.uint64(32)).astype(np.uint32), (both & np.uint64(0xFFFFFFFF)).astype(np.int32))


def _merged(old: Entries, new: Entries) -> Entries:
    at = np.searchsorted(old.keys, new.keys, side="right")
    return Entries(np.insert(old.keys, at, new.keys), np.insert(old.owners, at, new.owners))


def _head(table: Entries) -> tuple[NDArray[np.uint32], np.uint32]:
    """Rows at which the buckets begin, about an entry a bucket, and the shift that makes a key its bucket."""
    bits = min(KEY_BITS, max(8, len(table).bit_length()))
    shift = np.uint32(KEY_BITS - bits)
    edges = np.arange((1 << bits) + 1, dtype=np.uint64) << np.uint64(shift)
    return np.searchsorted(table.keys, edges.astype(np.uint32)).astype(np.uint32), shift
