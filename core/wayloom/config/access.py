"""Settings of access control: who must say who it is, how long that lasts, and how much anybody may ask for."""

from pydantic import Field

from wayloom.config.settings import Settings

DAY_S = 86400.0


class AccessSettings(Settings):
    """Keys, sessions, quotas of vehicles, rates of requests. Without a key and without `required` none of it applies."""

    required: bool = Field(False, description="want a key or a sign-in of every request, also where there is no api_key")
    trusted_proxies: str = Field(
        "127.0.0.1", description="addresses or networks, comma-separated, whose X-Forwarded-For and -Proto are believed"
    )
    session_s: float = Field(12 * 3600.0, gt=0, le=30 * DAY_S, description="seconds after which a sign-in has ended")
    held_s: float = Field(
        10.0, ge=0, le=300, description="seconds for which a process goes on with a key or session that another has revoked"
    )
    rotation_grace_s: float = Field(DAY_S, ge=0, description="seconds for which a key's secret before its rotation is still taken")

    drives_a_day: int = Field(200, ge=1, description="most drives that a vehicle may announce within 24 hours")
    bytes_a_day: int = Field(2 * 2**40, ge=1, description="most bytes of drives that a vehicle may announce within 24 hours")
    open_bytes: int = Field(2**40, ge=1, description="most bytes that a vehicle may have announced and not sent yet")
    requests_a_second: float = Field(1000.0, gt=0, description="of one key or user, by one process of the API, in the long run")
    requests_at_once: int = Field(10_000, ge=1, description="of one key or user, before that rate counts")
    strangers_a_second: float = Field(20.0, gt=0, description="requests of one address without a key that is known")
    strangers_at_once: int = Field(200, ge=1, description="likewise, before that rate counts")
