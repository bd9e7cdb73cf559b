"""Other methods, runnable, at the fidelity of ours: for the benchmark, sweeps and detectors. Start at `methods`."""
