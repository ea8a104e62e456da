"""Predictors without a model of propagation."""
