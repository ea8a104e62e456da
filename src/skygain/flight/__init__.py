"""Where UAVs may be: the swarm, its starts and the rules of the air."""
