"""What things cost as scenes, views and pictures grow. Start at `study`; `cost_charts` fits the exponents."""
