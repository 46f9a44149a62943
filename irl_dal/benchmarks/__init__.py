"""What the city can do, measured: speed, lane measurement, vehicle, faults."""
