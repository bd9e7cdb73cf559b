"""Pictures of models as other people's viewers draw them, in a real browser, and what verification makes of them."""
