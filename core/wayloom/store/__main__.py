"""`python -m wayloom.store`: migration of the database that the settings name."""

import sys

from wayloom.config.service import ServiceSettings
from wayloom.config.sources import load
from wayloom.errors import InputError
from wayloom.store.database import Database
from wayloom.store.migrate import upgrade


def main() -> int:
    """Migrate and end."""
    try:
        upgrade(Database(load(ServiceSettings, part=True).settings.database))
    except InputError as error:
        sys.stderr.write(f"wayloom: {error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
