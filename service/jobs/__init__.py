"""Jobs that survive: a port of our own, the durable engine behind it, and the processes that do the work."""
