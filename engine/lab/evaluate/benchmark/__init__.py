"""Protocols that compare methods of marking, ours and anybody's (docs/BENCHMARK.md). Start at `methods`."""
