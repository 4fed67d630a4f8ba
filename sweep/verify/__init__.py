"""A tuned device in the time domain, with and without damping control."""
