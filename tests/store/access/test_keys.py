"""Keys in the database: only the right text of a key that is good is known, and nothing in the database gives one away."""

import hashlib
from collections.abc import Callable

import pytest
from sqlalchemy import update

from wayloom.config.roles import Role
from wayloom.errors import ConfigError, ConflictError, NotFoundError
from wayloom.store.access import keys, secrets
from wayloom.store.database import Database
from wayloom.store.tables.access import AccessKey


def made(database: Database, **more: float | str) -> tuple[str, str]:
    """Prefix and text of a new key."""
    with database.write() as session:
        row, text = keys.create(session, "of a test", Role.VEHICLE, **more)  # type: ignore[arg-type]
        return row.prefix, text


def known(database: Database, text: str) -> keys.KnownKey | None:
    with database.read() as session:
        return keys.find(session, text)


def aged(database: Database, prefix: str, **columns: float) -> None:
    """The key as it will be when its times have come."""
    with database.write() as session:
        session.execute(update(AccessKey).where(AccessKey.prefix == prefix).values(**columns))


def test_a_key_is_found_by_its_text_and_kept_as_a_hash_alone(database: Database) -> None:
    prefix, text = made(database, vehicle_id="van-1")
    found = known(database, text)
    assert found is not None
    assert (found.prefix, found.role, found.vehicle_id, found.until) == (prefix, Role.VEHICLE, "van-1", None)
    with database.read() as session:
        row = keys.every(session)[0]
        kept = " ".join(str(getattr(row, column.name)) for column in AccessKey.__table__.columns)
    assert text.split("_", 2)[2] not in kept
    assert hashlib.sha256(text.encode()).hexdigest() in kept
    assert len(text.split("_", 2)[2]) >= 43  # 256 bits in base64


WRONG: dict[str, Callable[[str], str]] = {
    "another secret": lambda text: text[:-1] + ("A" if text[-1] != "A" else "B"),
    "a shorter secret": lambda text: text[:-1],
    "no secret": lambda text: text[:17],
    "another prefix": lambda text: f"wlk_{'0' * 12}_{text.split('_', 2)[2]}",
    "a prefix that is none": lambda text: text.replace("wlk_", "wlk_x"),
    "another kind": lambda text: text.replace("wlk_", "ghp_"),
    "capitals": lambda text: text.upper(),
    "nothing": lambda _: "",
    "the hash": lambda text: hashlib.sha256(text.encode()).hexdigest(),
    "zeros": lambda _: "0" * 64,
    "what is no text": lambda text: f"{text[:17]}\udcff\0é",
    "a wildcard": lambda _: f"wlk_{'%' * 12}_x",
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_not_exactly_the_key_is_unknown(database: Database, name: str) -> None:
    _, text = made(database)
    assert known(database, WRONG[name](text)) is None


def test_a_key_that_has_expired_or_is_revoked_is_unknown(database: Database) -> None:
    prefix, text = made(database, expires_in_s=60.0)
    found = known(database, text)
    assert found is not None
    assert found.until == pytest.approx(found.at + 60.0, abs=5.0)
    aged(database, prefix, expires_at=found.at - 1.0)
    assert known(database, text) is None
    prefix, text = made(database)
    with database.write() as session:
        keys.revoke(session, prefix)
    assert known(database, text) is None
    with database.write() as session:
        for change in (lambda: keys.revoke(session, prefix), lambda: keys.rotate(session, prefix, 60.0)):
            with pytest.raises(ConflictError, match="is revoked"):
                change()
        with pytest.raises(NotFoundError):
            keys.revoke(session, "0" * 12)


def test_the_secret_before_a_rotation_is_taken_for_its_grace_and_no_longer(database: Database) -> None:
    prefix, first = made(database)
    with database.write() as session:
        _, second = keys.rotate(session, prefix, grace_s=60.0)
    old, new = known(database, first), known(database, second)
    assert old is not None
    assert new is not None
    assert (old.prefix, new.prefix, new.until) == (prefix, prefix, None)
    assert old.until == pytest.approx(old.at + 60.0, abs=5.0)
    aged(database, prefix, old_until=old.at - 1.0)
    assert (known(database, first), known(database, second)) != (None, None)
    assert known(database, first) is None
    with database.write() as session:
        _, third = keys.rotate(session, prefix, grace_s=60.0)
    assert [known(database, text) is not None for text in (first, second, third)] == [False, True, True]


def test_a_rotation_without_grace_and_a_revocation_after_one_end_the_old_secret_at_once(database: Database) -> None:
    prefix, first = made(database)
    with database.write() as session:
        _, second = keys.rotate(session, prefix, grace_s=0.0)
    assert known(database, first) is None
    with database.write() as session:
        _, third = keys.rotate(session, prefix, grace_s=60.0)
        keys.revoke(session, prefix)
    assert [known(database, text) for text in (first, second, third)] == [None, None, None]


def test_a_key_that_is_not_there_is_compared_like_one_that_is(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    """As often, by the comparison whose time does not depend on the texts, and of hashes of one length."""
    _, text = made(database)
    compared: list[tuple[int, int]] = []

    def compare(one: bytes, other: bytes) -> bool:
        compared.append((len(one), len(other)))
        return one == other

    monkeypatch.setattr(secrets.hmac, "compare_digest", compare)
    for given in (text, text[:-1] + "_", f"wlk_{'0' * 12}_{'x' * 43}", "nothing like a key"):
        compared.clear()
        known(database, given)
        assert compared == [(64, 64), (64, 64)], given


def test_when_a_key_was_used_is_noted_once_in_a_while(database: Database) -> None:
    prefix, text = made(database)
    found = known(database, text)
    assert found is not None
    assert found.is_note_due
    with database.write() as session:
        keys.note_use(session, found.key_id)
    again = known(database, text)
    assert again is not None
    assert not again.is_note_due
    aged(database, prefix, used_at=again.at - keys.USED_EVERY_S - 1.0)
    later = known(database, text)
    assert later is not None
    assert later.is_note_due


def test_a_key_that_is_no_vehicles_is_bound_to_none(database: Database) -> None:
    with database.write() as session, pytest.raises(ConfigError, match="not bound to a vehicle"):
        keys.create(session, "x", Role.ADMIN, "van-1")
