"""What the handlers share: the caller, error responses, retries, lists, limits.

Every domain's endpoints come in. Start at `access` (who), `forms` (with what) and `job_responses` (how a job is answered).
"""
