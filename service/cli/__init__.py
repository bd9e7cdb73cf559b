"""Commands of the service, beside those of the engine. No other part imports them."""
