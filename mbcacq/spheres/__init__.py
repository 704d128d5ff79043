"""Ball centres from a cloud of points: segment, fit with the known diameter, recognise which ball is which."""

from mbcacq.spheres.extract import find_balls
from mbcacq.spheres.found import BallOptions, FoundBalls
from mbcacq.spheres.ply import centres_from_ply, read_cloud

__all__ = ["BallOptions", "FoundBalls", "centres_from_ply", "find_balls", "read_cloud"]
