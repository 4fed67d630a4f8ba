"""Small linear networks: elements at nodes, assembled into one descriptor system E x' = A x + B u."""
