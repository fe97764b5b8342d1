"""What the tests of the service share: a real service in its own processes, with small stages, and made-up drives for it."""
