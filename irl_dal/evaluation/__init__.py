"""Driving an agent, measuring the drives, showing the results."""
