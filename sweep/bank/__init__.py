"""Every grid of a bank with every operating point: run in parallel, resumed, written, drawn."""
