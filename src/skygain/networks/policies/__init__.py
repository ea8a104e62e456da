"""Networks that choose moves."""
