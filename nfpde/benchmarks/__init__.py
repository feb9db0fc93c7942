"""The paper's experiments: four Gymnasium robots (and a small pendulum), two populations, random recordings."""

from nfpde.benchmarks.collect import collect as collect
from nfpde.benchmarks.collect import record as record
from nfpde.benchmarks.hidden import Hidden as Hidden
from nfpde.benchmarks.hidden import hide as hide
from nfpde.benchmarks.pendulum import PAYLOAD_ID as PAYLOAD_ID
from nfpde.benchmarks.pendulum import PENDULUM_ID as PENDULUM_ID
from nfpde.benchmarks.robots import BENCHMARKS as BENCHMARKS
from nfpde.benchmarks.robots import ROBOTS as ROBOTS
from nfpde.benchmarks.robots import Robot as Robot
from nfpde.benchmarks.robots import robot as robot
from nfpde.benchmarks.targets import Target as Target
from nfpde.benchmarks.targets import population as population
