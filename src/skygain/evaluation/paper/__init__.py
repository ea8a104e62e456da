"""The paper's figures: what is flown for each, and whether its claims hold."""
