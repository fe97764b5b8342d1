"""HTTP client of the service: a drive's manifest, its resumable upload, and polling of its progress."""
