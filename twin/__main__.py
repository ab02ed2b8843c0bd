"""The command line, as ``python -m twin``."""

from twin.cli.main import main

main()
