"""The command line: one file per command, none of them imports anything heavy before it runs.

Nobody of the engine comes in; the service adds its commands to `app`. Start there, then `embed` and `verify`.
"""
