"""A benchmark for those who do not use Skygain: exported, flown and scored with NumPy alone."""
