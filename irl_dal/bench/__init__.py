"""Measured: the city (speed, lane measurement, vehicle, faults), plans and gradient steps."""
