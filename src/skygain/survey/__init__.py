"""The loop: what is believed, where to fly, what was measured."""
