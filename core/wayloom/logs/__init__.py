"""Drive logs: the recordings of vehicles, one reader a format. Start at `wayloom.logs.registry.open_log`."""
