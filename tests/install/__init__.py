"""What is installed, and what works without the rest."""
