"""The version of the program; every package may import it."""

__version__ = "1.0.0"
