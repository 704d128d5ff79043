"""Ball centres from a cloud of points: segment, fit with the known diameter, recognise which ball is which."""

from mbcacq.spheres.extract import find_spheres as find_spheres
from mbcacq.spheres.found import FoundSpheres as FoundSpheres
from mbcacq.spheres.found import SphereOptions as SphereOptions
from mbcacq.spheres.ply import centres_from_ply as centres_from_ply
from mbcacq.spheres.ply import read_cloud as read_cloud
