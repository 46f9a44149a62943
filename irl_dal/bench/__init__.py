"""Benchmarks of the city (speed, lane measurement, vehicle, faults) and the planner."""
