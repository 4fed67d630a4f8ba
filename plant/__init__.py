"""What is driven: the promise of a plant, its conformance check, the registry and the built-in plants."""
