"""Radar instruments at hand: XeThru X4 modules on a serial line, and PulsON radars on UDP."""
