"""The thesis reproduced: each of its experiments run both ways, its statements checked with numbers [Billdal2018]."""
