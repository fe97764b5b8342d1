"""`python -m wayloom.store`: migration of the database that the settings name; `grant-readonly ROLE`: who may read its geometry."""

import argparse
import sys

from wayloom.config.service import ServiceSettings
from wayloom.config.sources import load
from wayloom.errors import InputError
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.folders import Folders
from wayloom.store.migrate import upgrade
from wayloom.store.spatial.readers import READABLE, grant_readonly
from wayloom.store.spatial.shown_features import show_all


def main() -> int:
    """Do what the command line says, and end."""
    parser = argparse.ArgumentParser(prog="python -m wayloom.store", description="Without a command: migrate the database.")
    commands = parser.add_subparsers(dest="command")
    grant = commands.add_parser("grant-readonly", help="let a role of PostgreSQL read the geometry and nothing else")
    grant.add_argument("role", help="a role that exists")
    arguments = parser.parse_args()
    settings = load(ServiceSettings, part=True).settings
    database = Database(settings.database)
    try:
        if arguments.command == "grant-readonly":
            grant_readonly(database, arguments.role)
            sys.stdout.write(f"{arguments.role} may read {', '.join(READABLE)}\n")
        else:
            upgrade(database)
            show_all(database, BlobStore(Folders(settings.data_dir).blobs, settings.blob_url))
    except InputError as error:
        sys.stderr.write(f"wayloom: {error}\n")
        return 2
    finally:
        database.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
