"""Settings of the service: address, data folder, limits, time-outs."""

import hashlib
import ipaddress
import os
import re
import tempfile
from pathlib import Path

from pydantic import Field, field_validator

from wayloom.config.access import AccessSettings
from wayloom.config.retention import UploadSettings
from wayloom.config.settings import Settings
from wayloom.errors import ConfigError

LONGEST_SOCKET_PATH = 100
"""Bytes. Linux takes 107, macOS 103."""


class ServiceSettings(Settings):
    """What the API, the workers and the sweeper share, beside the settings of the stages. Made once a process."""

    data_dir: Path = Field(
        Path("wayloom-data"),
        validate_default=True,
        description="folder of the database, the uploads, the stages' outputs and the blobs",
    )
    database_url: str | None = Field(None, repr=False, description="SQLAlchemy URL; default SQLite in the data folder")
    broker_url: str | None = Field(None, repr=False, description="Redis or Valkey URL; default the Unix socket in the data folder")
    blob_url: str | None = Field(None, description="object store URL, s3://bucket/prefix; default a folder in the data folder")

    host: str = Field("127.0.0.1", description="address to listen on")
    port: int = Field(8088, ge=0, le=65535, description="port to listen on")
    api_key: str | None = Field(None, min_length=16, repr=False, description="required as a Bearer token under /v1 where set")
    allowed_hosts: str = Field(
        "", description="names that the service answers to, comma-separated; without a key always those of this machine alone"
    )
    access: AccessSettings = Field(AccessSettings(), description="keys, sign-ins, quotas, rates")
    uploads: UploadSettings = UploadSettings()
    request_head_s: float = Field(20.0, gt=0, description="seconds after which a request whose head has not come is dropped")
    body_pause_s: float = Field(60.0, gt=0, description="seconds without a byte after which a request's body is given up")
    map_id: str = Field("city", pattern=r"^[a-z0-9][a-z0-9-]{0,62}$", description="the map that drives go into")
    cors_origins: tuple[str, ...] = Field(
        (), description="origins whose pages may read the API, `https://maps.example`, or `*` for all; none by default"
    )
    held_blobs_bytes: int = Field(
        64 * 2**20, ge=0, description="bytes of tiles that an API process keeps in memory, those that were asked for last"
    )
    excluded_areas: Path | None = Field(
        None, description="GeoJSON file of polygons of which the map keeps nothing, beside those of /v1/excluded-areas"
    )
    map_versions_kept: int = Field(20, ge=1, description="older versions of a map are forgotten")

    stage_hooks: str = Field(
        "wayloom_workers.production:stage_hooks", description="module:NAME of the function that gives the workers' hooks of a stage"
    )
    rig_memory: bool = Field(True, description="learn each rig from its drives, and track the next ones with what is known")
    lease_s: float = Field(90.0, gt=0.5, description="seconds without a heartbeat after which a job is taken from its worker")
    heartbeat_s: float = Field(3.0, gt=0.05, description="seconds between heartbeats")
    sweep_s: float = Field(2.0, gt=0.05, description="seconds between two looks of the sweeper")
    resend_s: float = Field(10.0, gt=0.1, description="seconds after which a queued job that nobody has taken is sent again")
    max_attempts: int = Field(3, ge=1, le=20, description="attempts of one stage before the drive fails")
    max_losses: int = Field(
        20, ge=1, le=1000, description="workers that may be lost over one stage, whatever the reason, before it is quarantined"
    )
    stage_memory_bytes: int = Field(
        -1, ge=-1, description="most bytes that a worker may hold; 0: as much as there is; -1: 80 % of the machine's memory"
    )
    stage_limit_s: float = Field(7 * 86400.0, gt=0, description="seconds after which a stage that is not done has failed")
    retry_first_s: float = Field(5.0, gt=0, description="seconds before a failed stage is tried again; twice as long each time")
    retry_longest_s: float = Field(600.0, gt=0, description="longest pause before a failed stage is tried again, seconds")

    max_file_bytes: int = Field(64 * 2**30, gt=0, description="largest file of a drive, bytes")
    max_drive_files: int = Field(200_000, gt=0, description="most files of a drive")
    max_manifest_bytes: int = Field(
        64 * 2**20, ge=4096, description="longest manifest, bytes of JSON; some 150 for each of the drive's files"
    )
    min_free_bytes: int = Field(
        512 * 2**20, ge=0, description="uploads are refused (507) when less than this would stay free, bytes"
    )
    upload_expiry_s: float = Field(
        7 * 86400.0, gt=0, description="seconds after its last byte at which an unfinished upload is dropped"
    )

    @field_validator("data_dir")
    @classmethod
    def _absolute(cls, value: Path) -> Path:
        return value.expanduser().absolute()

    @field_validator("cors_origins")
    @classmethod
    def _origins(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for origin in value:
            if origin != "*" and not re.fullmatch(r"https?://[^/\s*]+", origin):
                raise ValueError(f"{origin!r} is no origin: scheme, host and port as in https://maps.example:8443, or *")
        return value

    @property
    def database(self) -> str:
        """The database's URL."""
        return self.database_url or f"sqlite:///{self.data_dir / 'wayloom.db'}"

    @property
    def broker(self) -> str:
        """The broker's URL as Celery wants it."""
        return self.broker_url or f"redis+socket://{self.broker_socket}"

    @property
    def broker_socket(self) -> Path:
        """The bundled broker's Unix socket: in the data folder, or, where its path is too long for the system, in a folder of the
        user's own among the temporary files, named after the data folder."""
        beside = self.data_dir / "valkey.sock"
        if len(os.fsencode(beside)) <= LONGEST_SOCKET_PATH:
            return beside
        name = hashlib.sha256(os.fsencode(self.data_dir)).hexdigest()[:16]
        return Path(tempfile.gettempdir()) / f"wayloom-{os.getuid()}-{name}" / "valkey.sock"

    @property
    def public(self) -> bool:
        """Whether other machines can reach the address that the API listens on."""
        if self.host == "localhost":
            return False
        try:
            return not ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return True

    @property
    def is_closed(self) -> bool:
        """Whether requests want a key or a sign-in."""
        return self.api_key is not None or self.access.required or self.access.oidc_issuer is not None

    def check_exposure(self) -> None:
        """Raise ConfigError when the API would be open to other machines without a key."""
        if self.public and not self.is_closed:
            raise ConfigError(
                f"{self.host} can be reached by other machines and no API key is set",
                remedy="set WAYLOOM_API_KEY (16 characters or more), or WAYLOOM_ACCESS__REQUIRED, or listen on 127.0.0.1",
            )
