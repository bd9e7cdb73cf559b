"""What the tables measure: one function a kind of cell, plain rows back."""
