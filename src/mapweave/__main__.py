"""`python -m mapweave`."""

from .cli import main

main()
