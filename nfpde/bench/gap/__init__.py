"""`nfpde bench gap`: robots with a hidden fault, and how well the diagnosis names it.

The faults are built here with MuJoCo alone, in other ways than the effects of the package, as an experimenter builds
them into a real robot; nothing here may import `nfpde.effects`, `nfpde.sim` or `nfpde.gap`.
"""
