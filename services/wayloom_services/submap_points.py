"""Points of a submap as they are handed out: those of drives that are there, without persons."""

from typing import Final

import numpy as np

from wayloom.config.classes import PERSONS
from wayloom.errors import ConflictError, NotFoundError
from wayloom.store import maps
from wayloom.submaps.submap import decode_submap
from wayloom_services.context import Service

MOST_KNOWN: Final = 100_000
_shows_nobody: Final = set[str]()
"""Digests of submaps that were looked through. Bytes of a digest never change: to decode them costs more than to send them."""


class WithheldError(ConflictError):
    """What is asked for shows persons."""

    code = "withheld"


async def submap_bytes(service: Service, digest: str) -> bytes:
    """The bytes of a submap. Raises NotFoundError where no drive has it, WithheldError where it holds points of persons, as do
    those of releases that kept them in a drive's own cloud."""
    if not await service.read(lambda session: maps.is_submap(session, digest)):
        raise NotFoundError(f"no drive has a submap {digest[:12]}")
    return await service.in_thread(lambda: _checked(service.blobs.get(digest), digest))


def _checked(content: bytes, digest: str) -> bytes:
    if digest not in _shows_nobody:
        submap = decode_submap(content, digest)
        if np.isin(submap.label, PERSONS).any() or np.isin(submap.vote_class, PERSONS).any():
            raise WithheldError(f"submap {digest[:12]} holds points of persons: process its drive anew")
        if len(_shows_nobody) >= MOST_KNOWN:
            _shows_nobody.clear()
        _shows_nobody.add(digest)
    return content
