"""Densities over the unconstrained parameters z."""

from nfpde.flow.adam import Adam as Adam
from nfpde.flow.density import Density as Density
from nfpde.flow.factory import make_density as make_density
from nfpde.flow.mixture import GaussianMixture as GaussianMixture
from nfpde.flow.model import INITIAL_SCALE as INITIAL_SCALE
from nfpde.flow.model import Flow as Flow
from nfpde.flow.model import FlowKind as FlowKind
from nfpde.flow.model import build_flow as build_flow
