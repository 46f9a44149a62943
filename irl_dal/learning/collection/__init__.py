"""Driving for the learners."""
