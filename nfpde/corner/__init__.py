"""Pictures of distributions."""

from nfpde.corner.corner import Sampler as Sampler
from nfpde.corner.corner import corner as corner
