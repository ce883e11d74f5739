"""Reproduce the thesis [Billdal2018]: run each experiment under both laws and check its statements with numbers."""
