"""Moving things: lanes, car-following vehicles, pedestrians, signals, routes and drives."""
