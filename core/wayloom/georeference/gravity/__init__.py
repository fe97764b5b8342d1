"""The direction of up, as accelerometers, streets and upright walls and poles show it."""
