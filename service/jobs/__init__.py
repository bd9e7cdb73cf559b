"""Durable jobs: their table and what runs them whatever dies (`durable_jobs`: DBOS), and the workers (`runner`)."""
