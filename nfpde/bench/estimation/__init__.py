"""`nfpde bench estimation`: trajectory beside softmax over robots, populations and noise; calibration by simulation."""

from nfpde.bench.estimation.calibration import calibrate as calibrate
from nfpde.bench.estimation.command import command as command
from nfpde.bench.estimation.grid import NOISES as NOISES
from nfpde.bench.estimation.grid import run as run
