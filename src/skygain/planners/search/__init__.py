"""How planners look for paths."""
