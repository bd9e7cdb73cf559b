"""Jobs that survive: a port of our own, the durable engine behind it, and the processes that do the work.

Handlers know `port` alone, the worker knows `worker`. Start at `port`, then `durable`; `child` runs the tasks.
"""
