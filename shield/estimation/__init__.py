"""From raw sensor readings to filtered estimates."""
