"""Users, their passwords and sessions in the database."""

import hashlib
import threading

import pytest
from argon2 import PasswordHasher, extract_parameters
from sqlalchemy import select, update

from wayloom.config.roles import Role
from wayloom.errors import ConfigError, ConflictError, NotFoundError
from wayloom.store.access import provided, users
from wayloom.store.access.passwords import is_right, password_hash
from wayloom.store.database import Database
from wayloom.store.tables.access import UserSession

PASSWORD = "correct horse battery staple"


def add(database: Database, name: str = "anna", role: Role = Role.OPERATOR) -> None:
    with database.write() as session:
        users.add(session, name, role, PASSWORD)


def signed_in(database: Database, name: str = "anna") -> str:
    with database.write() as session:
        return users.sign_in(session, users.get(session, name), "10.0.0.1", 60.0)


def found(database: Database, token: str) -> users.KnownSession | None:
    with database.read() as session:
        return users.find_session(session, token)


def test_a_password_is_kept_as_argon2id_and_recognised(database: Database) -> None:
    add(database)
    with database.read() as session:
        kept = users.get(session, "anna").password
    assert kept.startswith("$argon2id$v=19$m=65536,t=3,p=1$")
    assert is_right(PASSWORD, kept)
    for wrong in (PASSWORD + " ", "", PASSWORD.upper(), "\udcff", kept):
        assert not is_right(wrong, kept)
    assert not is_right("nobody's", None)  # what is verified where there is no user
    assert not is_right(PASSWORD, "no hash")


def test_a_name_without_a_user_costs_as_much_as_one_with(monkeypatch: pytest.MonkeyPatch) -> None:
    verified: list[str] = []
    monkeypatch.setattr(PasswordHasher, "verify", lambda _, kept, password: verified.append(kept))
    for kept in (None, password_hash(PASSWORD)):
        is_right(PASSWORD, kept)
    nobodys, annas = map(extract_parameters, verified)
    assert nobodys == annas


def test_what_is_no_user_is_refused(database: Database) -> None:
    with database.write() as session:
        for name in ("", "Anna", "an na", "a" * 65, "-a", "anna\n"):
            with pytest.raises(ConfigError, match="no name of a user"):
                users.add(session, name, Role.VIEWER, PASSWORD)
        with pytest.raises(ConfigError, match="12 to 256"):
            users.add(session, "anna", Role.VIEWER, "short")
        with pytest.raises(ConfigError, match="does not sign in"):
            users.add(session, "anna", Role.VEHICLE, PASSWORD)
        users.add(session, "anna", Role.VIEWER, PASSWORD)
        with pytest.raises(ConflictError):
            users.add(session, "anna", Role.ADMIN, PASSWORD)
        with pytest.raises(NotFoundError):
            users.get(session, "bert")


def test_a_session_is_found_by_its_token_which_is_kept_as_a_hash_until_it_is_over(database: Database) -> None:
    add(database)
    token = signed_in(database)
    known = found(database, token)
    assert known is not None
    assert (known.user, known.role) == ("anna", Role.OPERATOR)
    with database.read() as session:
        (kept,) = session.scalars(select(UserSession.token))
    assert kept == hashlib.sha256(token.encode()).hexdigest()
    assert found(database, kept) is None
    with database.write() as session:
        session.execute(update(UserSession).values(expires_at=known.at - 1.0))
    assert found(database, token) is None
    signed_in(database)
    with database.read() as session:
        assert len(session.scalars(select(UserSession)).all()) == 1  # the one that is over has gone


@pytest.mark.parametrize("how", ["sign-out", "password", "remove"])
def test_sessions_end_with_a_sign_out_another_password_and_the_user(database: Database, how: str) -> None:
    add(database)
    add(database, "bert")
    one, other, of_bert = signed_in(database), signed_in(database), signed_in(database, "bert")
    with database.write() as session:
        if how == "sign-out":
            users.sign_out(session, one)
        elif how == "password":
            users.set_password(session, "anna", "another good password")
        else:
            users.remove(session, "anna")
    assert found(database, one) is None
    assert (found(database, other) is not None) == (how == "sign-out")
    assert found(database, of_bert) is not None


def test_wrong_passwords_cost_waiting_that_doubles_and_a_right_one_ends_it(database: Database) -> None:
    add(database)
    waits = []
    with database.write() as session:
        user = users.get(session, "anna")
        for _ in range(users.FREE_FAILURES + 12):
            before = user.blocked_until
            users.note_failure(session, user)
            waits.append(None if user.blocked_until == before else user.blocked_until)
        started = min(wait for wait in waits if wait is not None) - users.WAIT.first_s
        assert waits[: users.FREE_FAILURES] == [None] * users.FREE_FAILURES
        lengths = [wait - started for wait in waits if wait is not None]
        assert lengths == pytest.approx([min(2.0 * 2**k, 300.0) for k in range(12)], abs=5.0)
        users.sign_in(session, user, "", 60.0)
        assert (user.failures, user.blocked_until) == (0, None)


def test_looking_a_user_up_waits_for_nobody_who_changes_it(database: Database) -> None:
    add(database)
    names: list[str] = []

    def look() -> None:
        with database.read() as session:
            user = users.named(session, "anna")
            names.append("nobody" if user is None else user.name)

    other = threading.Thread(target=look)
    with database.write() as session:
        users.note_failure(session, users.get(session, "anna"))
        session.flush()
        other.start()
        other.join(5.0)
        assert names == ["anna"]
    other.join()


def test_a_user_who_is_disabled_has_no_session_and_another_password_does_not_enable(database: Database) -> None:
    add(database)
    token = signed_in(database)
    with database.write() as session:
        users.disable(session, "anna")
        users.set_password(session, "anna", "another long password")
    assert found(database, token) is None
    with database.write() as session:
        assert users.is_disabled(users.get(session, "anna"))
        assert not users.is_disabled(users.enable(session, "anna"))


def test_a_user_of_a_provider_is_found_by_issuer_and_subject_and_no_password_is_right(database: Database) -> None:
    with database.write() as session:
        first = provided.renewed(session, "https://sso.example", "1", "Anna Ö.@x", Role.VIEWER)
        again = provided.renewed(session, "https://sso.example", "1", "another name", Role.ADMIN)
        others = [
            provided.renewed(session, issuer, subject, "Anna", Role.VIEWER) for issuer, subject in (("https://b", "1"), ("h", "2"))
        ]
        assert first is not None
        assert first is again
        assert (first.role, users.NAME.fullmatch(first.name) is not None, first.name.startswith("anna-")) == ("admin", True, True)
        assert len({first.name, *(one.name for one in others if one)}) == 3
        assert provided.renewed(session, "https://sso.example", "3", "nobody", None) is None
    for guess in ("", first.password, PASSWORD):
        assert not is_right(guess, first.password)
    with pytest.raises(ConfigError, match="OpenID"), database.write() as session:
        users.set_password(session, first.name, PASSWORD)
