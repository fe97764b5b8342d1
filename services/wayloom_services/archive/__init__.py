"""One archive of a drive's results: its endpoint, what is in it, and the zip that is made while it is sent."""
