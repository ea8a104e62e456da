"""What trained planners say of surveys that they were not trained for."""

from __future__ import annotations

import pytest

from skygain.planners.learned import dqn_planner, imitation_planner
from skygain.planners.random_waypoint import RandomWaypointPlanner


@pytest.mark.parametrize(
    ("predictor", "uavs", "quantity", "said"),
    [
        ("paper-unet", 3, "gain", ""),
        ("operator", 3, "gain", "trained for beliefs of paper-unet, here are those of operator"),
        ("paper-unet", 5, "gain", "trained for 3 UAVs, here are 5 UAVs"),
        ("paper-unet", 1, "power", "3 UAVs, gains in dB, here are 1 UAV, levels in dBm"),
    ],
)
def test_a_trained_planner_says_what_it_was_not_trained_for(
    predictor: str, uavs: int, quantity: str, said: str
) -> None:
    line = dqn_planner().outside_training(predictor, uavs=uavs, quantity=quantity)
    assert said in line
    assert bool(said) == bool(line)


def test_the_imitator_flew_any_number_on_three_beliefs() -> None:
    assert not imitation_planner().outside_training("operator", uavs=7)
    line = imitation_planner().outside_training("idw", uavs=7)
    assert "paper-unet and operator and kriging, here are those of idw" in line


def test_nobody_trained_the_others() -> None:
    assert not RandomWaypointPlanner().outside_training("idw", uavs=7, quantity="power")
