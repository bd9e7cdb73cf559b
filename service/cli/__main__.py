"""`python -m service.cli` is `mark3dgs`."""

from engine.cli.app import main

if __name__ == "__main__":
    main()
