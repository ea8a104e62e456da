"""Missions: from a real map to plans for drones, back with their readings, and on to the next."""
