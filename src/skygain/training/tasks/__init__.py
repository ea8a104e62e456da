"""What predictors learn from."""
