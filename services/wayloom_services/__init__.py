"""HTTP API, tile server and operator dashboard."""
