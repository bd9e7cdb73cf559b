"""Speed against accuracy: what each profile costs and what it buys. Start at `pareto_study`."""
