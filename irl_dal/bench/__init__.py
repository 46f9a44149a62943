"""Benchmarks of the city (speed, lane measurement, vehicle, faults), the planner and learners."""
