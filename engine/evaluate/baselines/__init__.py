"""Other methods, runnable: on the same scenes, at the same fidelity, under the same attacks as ours."""
