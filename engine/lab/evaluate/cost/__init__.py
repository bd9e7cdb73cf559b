"""What things cost as scenes, views and pictures grow. Start at `study`; `growth` fits the exponents."""
