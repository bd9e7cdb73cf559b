"""Durable jobs: what people see of a job (`rows`), the engine that runs it whatever dies (`engine`: DBOS), and workers.

Handlers know `port` and the class `DurableJobs`. Tasks run in processes of their own (`service.processes`).
"""
