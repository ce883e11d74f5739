"""Radar instruments at hand: XeThru X4 modules on a serial line, PulsON radars on UDP, and Acconeer's A121."""
