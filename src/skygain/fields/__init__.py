"""Gaussian fields on a grid: what Kriging, the operator and the planners share."""
