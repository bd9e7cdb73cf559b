"""Webhooks: a tenant's list (`endpoints`), where messages may go (`sending`), and taking them there (`delivery`)."""
