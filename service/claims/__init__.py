"""Claims: the signed answer of a verification, as JSON, as JWS and as a report to read."""
