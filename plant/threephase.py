"""The former name of `plant.space_vectors`, kept for one release."""

from .space_vectors import abc_of, vector_of

__all__ = ["abc_of", "vector_of"]
