"""`python -m microbundle` is the command line."""

from .cli import main

main()
