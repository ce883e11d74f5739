"""What the sensor receives."""
