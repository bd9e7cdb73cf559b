"""Commands of the service, beside those of the engine. `app` is the command `mark3dgs` itself; nobody comes in."""
