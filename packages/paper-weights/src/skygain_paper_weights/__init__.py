"""Weights of the paper's U-Nets; Skygain finds them in this folder."""
