"""Backups of a service that keeps everything in its data folder: taken while it runs, restored into an empty folder.

Start at `snapshot`, whose order of steps makes a copy consistent, then `restoration`.
"""
