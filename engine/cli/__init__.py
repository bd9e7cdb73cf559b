"""The command line: one file per command, none of them imports anything heavy before it runs.

No other room of the engine imports it; the service adds its commands to `app`. Start there, then `embed` and `verify`.
"""
