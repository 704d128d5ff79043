"""The version of the program; every room may import it."""

__version__ = "0.1.0"
