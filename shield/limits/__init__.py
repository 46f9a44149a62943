"""What the actuators can follow, as constraints that return rows."""
