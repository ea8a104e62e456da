"""Other people's Kriging, as predictors: scikit-learn, PyKrige, GSTools, GPyTorch."""
