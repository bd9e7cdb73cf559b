"""The laboratory: the simulator, attacks, studies and benches. Product code never imports it (an import contract)."""
