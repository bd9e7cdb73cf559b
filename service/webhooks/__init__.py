"""Webhooks: a tenant's list (`endpoints`), and taking messages there (`delivery`)."""
