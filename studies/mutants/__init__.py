"""Errors in methods, worlds and flights, and the statements about the thesis that each must break."""
