"""Worlds: materials, geometry and world files."""
