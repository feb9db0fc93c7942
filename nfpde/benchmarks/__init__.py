"""The paper's experiments: four Gymnasium robots, two populations, random recordings."""

from nfpde.benchmarks.collect import collect as collect
from nfpde.benchmarks.robots import ROBOTS as ROBOTS
from nfpde.benchmarks.robots import Robot as Robot
from nfpde.benchmarks.robots import robot as robot
from nfpde.benchmarks.targets import Target as Target
from nfpde.benchmarks.targets import population as population
