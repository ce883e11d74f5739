"""Scenarios, run and judged."""
