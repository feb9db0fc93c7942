"""Warp kernels, in the form MuJoCo Warp gives its own: imports warp and nothing of nfpde.

Arguments come in groups, each under its comment: `# Model:`, `# Data in:`, `# In:`, `# Data out:`, `# Out:`; names
end in `_in` or `_out`; the first index of a launch is the world. No kernel allocates anything.

A world simulates one row of the staged parameters on one window of the recordings:

=================== ================================================= =====================
`world_row`         the staged row of each world                      (nworld,)
`world_window`      the window each world replays                     (nworld,)
`alive`             1 until the simulation diverges, then 0           (nworld,)
`step`              control steps done since the start of the windows (1,)
`values`            parameters of the effects, of all staged rows     (nrow, nvalue)
`active`            whether an effect acts in a row at all            (nrow, neffect)
=================== ================================================= =====================
"""
