"""A deterministic ray launcher in vertical planes."""
