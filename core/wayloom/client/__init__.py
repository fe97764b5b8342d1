"""The HTTP client: a drive's manifest, its resumable upload, and the watch over what becomes of it."""
