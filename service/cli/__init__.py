"""Commands of the service, in addition to the engine's. No other part imports them."""
