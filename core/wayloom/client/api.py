"""HTTP requests to one wayloom server with retries; every failure is a ServiceError that holds the server's answer."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any, Self

import httpx2

from wayloom.config.backoff import Backoff
from wayloom.errors import ConfigError, NotFoundError, ServiceError

RETRIED_STATUS = frozenset({423, 429, 500, 502, 503, 504})
LONGEST_WAIT_S = 30.0
"""What takes longer by the server's word is not waited for."""
RETRIES = Backoff(first_s=0.25, longest_s=16.0, tries=8)
TIMEOUT = httpx2.Timeout(connect=10.0, read=120.0, write=120.0, pool=None)


def check_address(url: str) -> None:
    """Raises ConfigError where an address of a server lacks its scheme."""
    if not url.startswith(("http://", "https://")):
        raise ConfigError(f"{url} is no address of a server", remedy=f"give it with its scheme: http://{url}")


class AnswerError(ServiceError):
    """The server refused. `status` and `code` are those of its problem document, `after_s` the seconds of its Retry-After."""

    def __init__(self, status: int, code: str, detail: str, after_s: float = 0.0) -> None:
        super().__init__(f"the server answered {status}: {detail}")
        self.status, self.code, self.after_s = status, code, after_s

    @property
    def is_passing(self) -> bool:
        """Whether it may be answered otherwise when it is asked again soon. A quota that is used up is not."""
        return self.status in RETRIED_STATUS and self.after_s <= LONGEST_WAIT_S


class Api:
    """Requests with the key, tried again with growing pauses while the server is away. Safe to share between threads."""

    def __init__(self, url: str, key: str | None = None, connections: int = 4, retries: Backoff = RETRIES) -> None:
        key = key or os.environ.get("WAYLOOM_API_KEY")
        check_address(url)
        headers = {"Authorization": f"Bearer {key}"} if key else {}
        limits = httpx2.Limits(max_connections=connections + 2, max_keepalive_connections=connections + 2)
        self._retries = retries
        try:
            self._client = httpx2.Client(base_url=url.rstrip("/"), headers=headers, timeout=TIMEOUT, limits=limits, trust_env=False)
        except httpx2.InvalidURL as error:
            raise ServiceError(f"{url} is no address of a server: {error}") from None
        self.url = url.rstrip("/")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Close every connection."""
        self._client.close()

    def json(self, method: str, path: str, **request: Any) -> Any:
        """The answer's JSON, after as many tries as it takes. Raises AnswerError, ServiceError."""
        return self._answer(method, path, **request).json()

    def content(self, path: str) -> bytes:
        """The bytes at a path, likewise."""
        return bytes(self._answer("GET", path).content)

    def _answer(self, method: str, path: str, **request: Any) -> httpx2.Response:
        for is_last in self._retries.attempts():
            try:
                return self.once(method, path, **request)
            except ServiceError as error:
                passing = not isinstance(error, AnswerError) or error.is_passing
                if is_last or not passing:
                    raise
        raise AssertionError("the last try either returns or raises")

    def once(self, method: str, path: str, **request: Any) -> httpx2.Response:
        """One request. Raises AnswerError for an answer of 400 and above, ServiceError when none comes."""
        try:
            response = self._client.request(method, path, **request)
        except httpx2.HTTPError as error:
            what = f"{self.url} does not answer: {str(error) or type(error).__name__}"
            raise ServiceError(
                f"{what}; is `wayloom up` running there?" if isinstance(error, httpx2.ConnectError) else what
            ) from error
        if response.status_code >= 400:
            raise _refusal(response)
        return response

    @contextmanager
    def streamed(self, path: str) -> Iterator[httpx2.Response]:
        """The answer at a path before its body has come, tried once. Raises AnswerError, and ServiceError where none comes or the
        body breaks off while it is read in the block."""
        try:
            with self._client.stream("GET", path) as response:
                if response.status_code >= 400:
                    response.read()
                    raise _refusal(response)
                yield response
        except httpx2.HTTPError as error:
            raise ServiceError(f"the answer of {self.url} broke off: {str(error) or type(error).__name__}") from error

    def drive(self, drive_id: str) -> dict[str, Any]:
        """A drive with its stages. Raises NotFoundError when it was removed."""
        try:
            found: dict[str, Any] = self.json("GET", f"/v1/drives/{drive_id}")
        except AnswerError as error:
            if error.status == 404:
                raise NotFoundError(f"drive {drive_id[:12]} is not on the server any more") from None
            raise
        return found


def _refusal(response: httpx2.Response) -> AnswerError:
    wait = response.headers.get("retry-after", "")
    try:
        body = response.json()
        return AnswerError(response.status_code, str(body["code"]), str(body["detail"]), float(wait) if wait.isdigit() else 0.0)
    except (ValueError, KeyError, TypeError):
        return AnswerError(
            response.status_code, "error", f"{response.reason_phrase or 'no reason given'} (is it a wayloom server?)"
        )
