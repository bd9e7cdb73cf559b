"""The laboratory's commands: `attack`, `sim`, `evaluate` and `demo`; `mark3dgs` finds them by their entry points."""
