"""What others rely on: keys and their seals, the audit log, signatures and time stamps.

Everything above may come in; no task of `service.work` may. Start at `audit` (the log), `signing` and `master`.
"""
