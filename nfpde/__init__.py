"""Distributions over a MuJoCo model's parameters from logs of real robots.

The public names, in the order of the pipeline: recordings, parameters, effects, simulator, fit, distribution,
evaluation. Policies live in `nfpde.rl`, exact optimal transport in `nfpde.ot`.
"""

from nfpde.starting import stopped_early as _stopped_early

try:  # some of these take seconds
    from nfpde.dataset import Dataset as Dataset
    from nfpde.dataset import Episode as Episode
    from nfpde.dataset import Metadata as Metadata
    from nfpde.dataset import Windows as Windows
    from nfpde.dataset import load_dataset as load_dataset
    from nfpde.dataset import load_dropo as load_dropo
    from nfpde.dataset import resample_episode as resample_episode
    from nfpde.dataset import save_dataset as save_dataset
    from nfpde.distribution import ParameterDistribution as ParameterDistribution
    from nfpde.effects import DataScales as DataScales
    from nfpde.effects import Effect as Effect
    from nfpde.effects import Quantity as Quantity
    from nfpde.effects import World as World
    from nfpde.effects import effect as effect
    from nfpde.effects import effect_names as effect_names
    from nfpde.effects import register as register
    from nfpde.errors import NfpdeError as NfpdeError
    from nfpde.estimation import FitResult as FitResult
    from nfpde.estimation import NfpdeConfig as NfpdeConfig
    from nfpde.estimation import TrajectoryConfig as TrajectoryConfig
    from nfpde.estimation import fit as fit
    from nfpde.evaluate import Evaluation as Evaluation
    from nfpde.evaluate import evaluate as evaluate
    from nfpde.explained import explained_space as explained_space
    from nfpde.gap import GapReport as GapReport
    from nfpde.gap import diagnose_gap as diagnose_gap
    from nfpde.parameters import Parameter as Parameter
    from nfpde.parameters import ParameterSpace as ParameterSpace
    from nfpde.sim import CallableSimulator as CallableSimulator
    from nfpde.sim import MujocoSimulator as MujocoSimulator
    from nfpde.sim import Simulator as Simulator
    from nfpde.truth import Truth as Truth
except KeyboardInterrupt:
    _stopped_early()
