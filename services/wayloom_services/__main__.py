"""API server process (`python -m wayloom_services`): on an address, or on a socket that the parent has opened (--fd)."""

import argparse
import socket
import sys

import uvicorn

from wayloom.config.json_log import configure_log
from wayloom.errors import WayloomError
from wayloom.pipeline.settings import load_settings
from wayloom.pipeline.usable import check_usable
from wayloom_services.app import create_app
from wayloom_services.collector import spare_what_is_loaded
from wayloom_services.connections import patient_protocol

GRACE_S = 3


def main() -> int:
    """Serve until told to stop."""
    parser = argparse.ArgumentParser(prog="python -m wayloom_services")
    parser.add_argument("--fd", type=int, help="an open listening socket")
    arguments = parser.parse_args()
    configure_log()
    try:
        loaded = load_settings()
        settings = loaded.settings
        settings.check_exposure()
        check_usable(loaded, runs_stages=False)
    except WayloomError as error:
        sys.stderr.write(f"wayloom: {error}\n")
        return 2
    app = create_app(settings)
    spare_what_is_loaded()
    config = uvicorn.Config(
        app,
        settings.host,
        settings.port,
        log_level="warning",
        timeout_graceful_shutdown=GRACE_S,
        server_header=False,
        forwarded_allow_ips=settings.access.trusted_proxies,
        http=patient_protocol(settings.request_head_s),
    )
    sockets = None if arguments.fd is None else [socket.socket(fileno=arguments.fd)]
    uvicorn.Server(config).run(sockets)
    return 0


if __name__ == "__main__":
    sys.exit(main())
