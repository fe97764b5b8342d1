"""Trajectory and label metrics, and the benchmarks behind `wayloom benchmark`."""
