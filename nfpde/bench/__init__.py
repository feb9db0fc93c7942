"""Benchmarks of the package itself; `nfpde bench` runs them."""
