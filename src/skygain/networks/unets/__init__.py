"""U-Nets from readings and a city map to gain and variance."""
