"""Surveys as missions: one whole survey from request to results, recorded campaigns, files for other tools."""
