"""The OpenID provider of a service, where there is one: the settings name it, and the extra `oidc` is installed."""

from importlib.util import find_spec
from typing import TYPE_CHECKING

import structlog

from wayloom.config.access import AccessSettings
from wayloom.config.extras import remedy_of

if TYPE_CHECKING:
    from wayloom_services.access.oidc.provider import Provider

log = structlog.get_logger()


def provider_of(settings: AccessSettings) -> "Provider | None":
    """The provider; None where none is named, or the packages that speak to it are not there. Raises ConfigError."""
    if settings.oidc_issuer is None:
        return None
    if find_spec("authlib") is None or find_spec("joserfc") is None:
        log.warning("no sign-in by OpenID Connect: its packages are not installed", remedy=remedy_of("oidc"))
        return None
    from wayloom_services.access.oidc.provider import Provider

    return Provider(settings)
