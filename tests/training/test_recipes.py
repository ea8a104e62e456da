"""Recipes by name."""

from dataclasses import replace

from skygain.training.recipes import RECIPES


def test_recipes_are_the_papers():
    paper = RECIPES["paper-unet"]
    assert (paper.learning_rate, paper.betas, paper.epsilon, paper.batch_size) == (
        1e-3,
        (0.9, 0.999),
        1e-6,
        160,
    )
    assert replace(paper.task, blind=True) == RECIPES["paper-unet-mapblind"].task
