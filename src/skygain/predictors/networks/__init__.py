"""Predictors with trained weights."""
