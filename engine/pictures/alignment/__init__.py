"""A picture laid over the reference's render: geometry, light, tone, background, and the residual that is left."""
