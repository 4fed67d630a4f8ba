"""Operating points that follow from a grid, and the worst of a region on one grid or on a bank."""
