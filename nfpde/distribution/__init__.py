"""Distributions over the physical parameters: sample, evaluate, summarise, save and load."""

from nfpde.distribution.distribution import ParameterDistribution as ParameterDistribution
from nfpde.distribution.summary import ParameterSummary as ParameterSummary
from nfpde.distribution.summary import Summary as Summary
