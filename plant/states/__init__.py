"""How a plant's state is kept, so that many runs branch from it: snapshots, replays from cold, forks."""
