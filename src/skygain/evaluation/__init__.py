"""How methods are flown, scored and compared."""
