"""The reference turbine: its plant, its parameters, its equilibrium and the lanes of its kernel."""
