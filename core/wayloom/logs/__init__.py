"""Drive logs: what a vehicle recorded, whatever the format. Start at `wayloom.logs.registry.open_log`."""
