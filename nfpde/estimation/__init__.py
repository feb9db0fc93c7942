"""Estimators: from recordings and a simulator to a distribution over its parameters."""

from nfpde.estimation.config import NfpdeConfig as NfpdeConfig
from nfpde.estimation.config import TrajectoryConfig as TrajectoryConfig
from nfpde.estimation.fit import CONFIGS as CONFIGS
from nfpde.estimation.fit import Method as Method
from nfpde.estimation.fit import fit as fit
from nfpde.estimation.nfpde import NfpdeTrainer as NfpdeTrainer
from nfpde.estimation.pictures import draw_fit as draw_fit
from nfpde.estimation.report import write_report as write_report
from nfpde.estimation.result import FitResult as FitResult
from nfpde.estimation.tell import tell as tell
