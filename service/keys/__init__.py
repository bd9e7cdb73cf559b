"""Owner keys held for their tenants, sealed under the master key."""
