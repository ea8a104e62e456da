"""How predictors and policies are trained."""
