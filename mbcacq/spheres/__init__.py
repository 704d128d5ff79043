"""Ball centres from a cloud of points: segment, fit with the known diameter, recognise which ball is which."""

from mbcacq.spheres.extract import find_spheres
from mbcacq.spheres.found import FoundSpheres, SphereOptions
from mbcacq.spheres.ply import centres_from_ply, read_cloud

__all__ = ["SphereOptions", "FoundSpheres", "centres_from_ply", "find_spheres", "read_cloud"]
