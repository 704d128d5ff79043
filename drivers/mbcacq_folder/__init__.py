"""Scanners with a program of their own that saves clouds into a folder: the program is triggered, the cloud is taken from the folder."""
