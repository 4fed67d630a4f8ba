"""Additional resonance damping control (ARDC): the control law, the estimator of the resonance, and runs in time."""
