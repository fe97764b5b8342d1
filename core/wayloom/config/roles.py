"""Roles of keys and users, and the rights of each."""

from collections.abc import Mapping
from enum import StrEnum
from typing import Final


class Role(StrEnum):
    """The part that a key or a user plays."""

    VEHICLE = "vehicle"
    VIEWER = "viewer"
    OPERATOR = "operator"
    ADMIN = "admin"


class Right(StrEnum):
    """What a request may need.

    FOLLOW   see drives: of a vehicle its own alone
    SEND     announce drives and upload their files
    READ     maps, tiles, features, rigs, lineage, numbers of the service
    OPERATE  retry, cancel, process anew, release and remove drives
    MANAGE   keys, users, audit log
    """

    FOLLOW = "follow"
    SEND = "send"
    READ = "read"
    OPERATE = "operate"
    MANAGE = "manage"


RIGHTS: Final[Mapping[Role, frozenset[Right]]] = {
    Role.VEHICLE: frozenset({Right.FOLLOW, Right.SEND}),
    Role.VIEWER: frozenset({Right.FOLLOW, Right.READ}),
    Role.OPERATOR: frozenset({Right.FOLLOW, Right.READ, Right.SEND, Right.OPERATE}),
    Role.ADMIN: frozenset(Right),
}
