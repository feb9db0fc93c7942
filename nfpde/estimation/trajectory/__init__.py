"""The episode-level estimator: an episode has one robot, and all its transitions share one parameter vector."""

from nfpde.estimation.trajectory.estimator import TrajectoryEstimator as TrajectoryEstimator
from nfpde.estimation.trajectory.modes import LocalPosterior as LocalPosterior
from nfpde.estimation.trajectory.population import prior_density as prior_density
from nfpde.estimation.trajectory.population import smoothing_matrix as smoothing_matrix
from nfpde.estimation.trajectory.problem import make_problem as make_problem
