"""The version of the program; every package may import it."""

__version__ = "0.1.0"
