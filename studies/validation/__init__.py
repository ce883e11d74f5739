"""Validation of the physical radar: oracles that share no code with it, and real recordings beside simulations."""
