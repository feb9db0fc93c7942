"""Policies: soft actor-critic on parameters drawn from a distribution, evaluated on the target's.

>>> from nfpde.parameters import Parameter, ParameterSpace
>>> from nfpde.rl import RandomizedParameters, make_environment
>>> space = ParameterSpace([Parameter("body_mass", "pendulum", 0.4, 1.6)])
>>> env = RandomizedParameters(make_environment("pendulum"), [1.1], space)
>>> env.reset(seed=0)[1]
{'parameters': {'body_mass:pendulum': 1.1}}
"""

from nfpde.rl.evaluate import Evaluation as Evaluation
from nfpde.rl.evaluate import evaluate_policy as evaluate_policy
from nfpde.rl.history import TrainResult as TrainResult
from nfpde.rl.learner import SacConfig as SacConfig
from nfpde.rl.past import Controller as Controller
from nfpde.rl.past import PastCommands as PastCommands
from nfpde.rl.policy import Policy as Policy
from nfpde.rl.policy import load_policy as load_policy
from nfpde.rl.randomize import RandomizedParameters as RandomizedParameters
from nfpde.rl.tasks import TASKS as TASKS
from nfpde.rl.tasks import make_environment as make_environment
from nfpde.rl.train import train_sac as train_sac
