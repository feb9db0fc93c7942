"""`python -m nfpde` is the command line."""

from nfpde.cli import main

main()
