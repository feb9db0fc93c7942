"""The faults, one family a file; each is built on MuJoCo alone."""
