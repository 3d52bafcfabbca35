"""`python -m leactl` is the command `leactl`."""

from leactl.cli.main import main

main()
