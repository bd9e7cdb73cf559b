"""The ownership-verification service: REST, jobs, registry, signed claims, a page. The engine does the work."""
