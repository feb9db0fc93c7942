"""Which of MuJoCo Warp's devices the twin tests run on: Warp's CPU device, or a GPU where one is asked for."""

import os

from nfpde.sim.warp_device import WarpDevice

CUDA = os.environ.get("NFPDE_TEST_DEVICE") == "cuda"
WARP: WarpDevice = "cuda" if CUDA else "warp-cpu"
