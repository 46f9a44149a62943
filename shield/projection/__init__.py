"""The nearest admissible horizon: solve, repair, check, certify."""
