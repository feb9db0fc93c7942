"""Distributions over a MuJoCo model's parameters from logs of real robots."""
