"""`python -m service.cli` is `mark3dgs`."""

from service.cli.app import main

main()
