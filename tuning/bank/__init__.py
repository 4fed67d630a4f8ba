"""A bank of grids: what is in it, and the judgement of one device on one of them."""
