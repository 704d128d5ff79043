"""The published method (Zhou et al. 2025), stage by stage; every stage can be called alone."""

from mbcacq.calibration.staged.method import calibrate_paper as calibrate_paper
