"""What the handlers share: who is asking, how errors are said, retries, lists, limits.

Every domain's endpoints come in. Start at `access` (who), `forms` (with what) and `answers` (how a job is answered).
"""
