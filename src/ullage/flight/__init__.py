"""Motion of the drone and its own estimate of it."""
