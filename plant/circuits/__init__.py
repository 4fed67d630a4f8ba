"""Lumped networks in time: branches between nodes, their own exact update, what is kept when something is switched."""
