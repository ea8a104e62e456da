"""Planners by name."""

from __future__ import annotations

__all__ = ["PLANNERS", "Certificate", "Plan", "Planner", "create_planner"]

from typing import Any

from skygain.ground.registry import Registry
from skygain.planners.base import Certificate, Plan, Planner

PLANNERS: Registry[Planner] = Registry("planner", "skygain.planners")
PLANNERS.register("random-waypoint", "skygain.planners.random_waypoint:RandomWaypointPlanner")
PLANNERS.register("lawnmower", "skygain.planners.lawnmower:LawnmowerPlanner")
PLANNERS.register("spiral", "skygain.planners.lawnmower:SpiralPlanner")
PLANNERS.register("entropy-vi", "skygain.planners.entropy_value_iteration:EntropyPlanner")
PLANNERS.register(
    "entropy-vi-conditioned", "skygain.planners.entropy_value_iteration:conditioned_entropy_planner"
)
PLANNERS.register(
    "independent-greedy", "skygain.planners.sequential_greedy:independent_greedy_planner"
)
PLANNERS.register("sequential-greedy", "skygain.planners.sequential_greedy:SequentialGreedyPlanner")
PLANNERS.register("greedy-variance", "skygain.planners.variance_greedy:GreedyVariancePlanner")
PLANNERS.register("min-cost-path", "skygain.planners.min_cost_path:MinCostPathPlanner")
PLANNERS.register("lookahead", "skygain.planners.lookahead:LookaheadPlanner")
PLANNERS.register("roadmap", "skygain.planners.roadmap:RoadMapPlanner")
PLANNERS.register("dqn", "skygain.planners.learned:dqn_planner")
PLANNERS.register("imitation", "skygain.planners.learned:imitation_planner")
PLANNERS.register("mcts", "skygain.planners.sequential_greedy:tree_search_planner")


def create_planner(name: str, **options: Any) -> Planner:
    """The planner called ``name``; an unknown name is an error that lists the known ones."""
    return PLANNERS.create(name, **options)
