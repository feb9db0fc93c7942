"""Warp kernels: imports warp and nothing of nfpde."""
