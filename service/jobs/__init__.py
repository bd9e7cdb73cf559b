"""Durable jobs: what people see of a job (`rows`), what runs it whatever dies (`durable_jobs`: DBOS), and workers.

Handlers know `port` and the class `DurableJobs`. Tasks run in processes of their own (`service.processes`).
"""
