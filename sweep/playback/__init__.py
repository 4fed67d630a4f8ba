"""Perturbation files for devices that are elsewhere, and the manifest that describes them."""
