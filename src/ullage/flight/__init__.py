"""How the drone moves, and what it believes of that."""
