"""A region of operating points, swept where a surrogate over it is least sure."""
