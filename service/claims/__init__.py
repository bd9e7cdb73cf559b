"""Claims: the signed answer of a verification, as JSON, as JWS and as a report to read.

Verifications come in to issue them. Start at `issuing`; `offline` checks a claim with nothing but public keys.
"""
