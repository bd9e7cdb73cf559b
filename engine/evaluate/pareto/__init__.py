"""Speed against accuracy: what each setting costs and what it buys."""
