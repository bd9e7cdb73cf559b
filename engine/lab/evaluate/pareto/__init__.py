"""Speed against accuracy: what each setting costs and what it buys. Start at `points`, the settings compared."""
