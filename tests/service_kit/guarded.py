"""A service that asks who calls, with a key of every role, and a drive of each of two vehicles."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import httpx2

from service_kit.running import ApiAlone
from service_kit.tus import create
from wayloom.config.roles import Role
from wayloom.store.access import keys, users
from wayloom.store.database import Database

API_KEY = "the key of the settings"
PASSWORD = "correct horse battery staple"
DIGEST = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
OURS, THEIRS = "van-1", "van-2"
FROM_PAGE = {"X-Requested-With": "wayloom"}


class Guarded:
    """The service, its database, and a client that says itself who it is."""

    def __init__(self, data: Path, **variables: str) -> None:
        self.api = ApiAlone(data, **{"WAYLOOM_API_KEY": API_KEY, **variables})
        self.database = Database(variables.get("WAYLOOM_DATABASE_URL", f"sqlite:///{data / 'wayloom.db'}"))
        self.http = httpx2.Client(base_url=self.api.url, timeout=30.0, trust_env=False)
        self._drives = 0

    def close(self) -> None:
        """Stop everything."""
        self.http.close()
        self.database.close()
        self.api.close()

    def key(self, role: Role, vehicle_id: str | None = None, expires_in_s: float | None = None) -> str:
        """A new key's text."""
        with self.database.write() as session:
            return keys.create(session, f"{role} of a test", role, vehicle_id, expires_in_s)[1]

    def user(self, name: str, role: Role) -> None:
        """A new user with the password."""
        with self.database.write() as session:
            users.add(session, name, role, PASSWORD)

    def browser(self) -> httpx2.Client:
        """A client with cookies of its own that sends what the dashboard's pages send."""
        return httpx2.Client(base_url=self.api.url, timeout=30.0, trust_env=False, headers=FROM_PAGE)

    def sign_in(self, client: httpx2.Client, name: str, password: str = PASSWORD) -> httpx2.Response:
        """As the sign-in page does."""
        return client.post("/v1/session", json={"name": name, "password": password})

    def announce(self, key: str, size: int = 10, **more: Any) -> httpx2.Response:
        """Announce a drive that nobody has announced before."""
        self._drives += 1
        file = {"path": "log/a", "size": size, "sha256": DIGEST}
        body = {"name": f"drive {self._drives} of a test", "files": [file], **more}
        return self.http.post("/v1/drives", json=body, headers=bearer(key))

    def drive(self, key: str) -> str:
        """A new drive's id."""
        answer = self.announce(key)
        assert answer.status_code == 201, answer.text
        return str(answer.json()["id"])

    def upload(self, key: str, drive: str) -> str:
        """The id of a new upload to a drive."""
        answer = create(self.http, drive, "log/a", 10, **bearer(key))
        assert answer.status_code == 201, answer.text
        return answer.headers["Location"].rpartition("/")[2]


def bearer(key: str | None) -> Mapping[str, str]:
    """The header of a key; none of none."""
    return {} if key is None else {"Authorization": f"Bearer {key}"}
