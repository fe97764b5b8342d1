"""Access control of the API: who asks, what a route needs, how often, and the trail of what was done and refused."""
