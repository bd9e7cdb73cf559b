"""What the handlers share: the caller, error responses, retries, lists, limits.

Every domain's endpoints come in. Start at `access` (caller), `forms` (request) and `job_responses` (answer).
"""
