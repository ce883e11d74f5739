"""`python -m ullage` is the `ullage` command."""

from ullage.cli import main

main()
