"""A sealed controller inside the circuit of the reference turbine."""
