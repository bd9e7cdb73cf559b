"""The ownership-verification service: REST, jobs, registry, signed claims, a page. The engine does the work.

Its commands are the entry. Start at `app` (the API) and `worker` (the jobs); docs/SERVICE.md has the
order of the rooms.
"""
