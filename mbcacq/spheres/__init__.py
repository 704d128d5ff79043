"""Ball centres from a cloud of points: segment, fit with the known diameter, recognise which ball is which."""
