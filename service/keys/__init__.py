"""Owner keys over HTTP, held for their tenants; how they are sealed is in `service.trust.owner_keys`."""
