"""The likelihood mapper: echoes from matched sums, surfaces tracked over the flight, cells rendered from surfaces."""
