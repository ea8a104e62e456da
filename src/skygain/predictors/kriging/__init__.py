"""Kriging with a known, inferred or no transmitter."""
