"""`python -m cloak_core ...` is `cloak ...`: what torchrun starts."""

from cloak_core.cli import main

main()
