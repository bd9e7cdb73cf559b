"""Is it alive, is it ready, what does it do: for probes and dashboards. All in `endpoints`."""
