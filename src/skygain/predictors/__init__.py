"""Predictors by name."""

from __future__ import annotations

__all__ = ["PREDICTORS", "Belief", "Predictor", "create_predictor"]

from typing import Any

from skygain.ground.registry import Registry
from skygain.predictors.base import Belief, Predictor

PREDICTORS: Registry[Predictor] = Registry("predictor", "skygain.predictors")
PREDICTORS.register("kriging", "skygain.predictors.kriging.known_source:KrigingPredictor")
PREDICTORS.register("kriging-blind", "skygain.predictors.kriging.known_source:blind_kriging")
PREDICTORS.register(
    "kriging-quadratic", "skygain.predictors.kriging.known_source:quadratic_kriging"
)
PREDICTORS.register("kriging-inferred", "skygain.predictors.kriging.known_source:inferred_kriging")
PREDICTORS.register("launched", "skygain.predictors.kriging.known_source:launched_kriging")
PREDICTORS.register("local-kriging", "skygain.predictors.kriging.local:LocalKrigingPredictor")
PREDICTORS.register("gids", "skygain.predictors.interpolators.gids:GidsPredictor")
PREDICTORS.register("thin-plate", "skygain.predictors.interpolators.thin_plate:ThinPlatePredictor")
PREDICTORS.register("idw", "skygain.predictors.interpolators.idw:IdwPredictor")
PREDICTORS.register("knn", "skygain.predictors.interpolators.knn:KnnPredictor")
PREDICTORS.register("operator", "skygain.predictors.networks.operator:OperatorPredictor")
PREDICTORS.register("adaptive", "skygain.predictors.adaptive:AdaptivePredictor")
PREDICTORS.register("paper-unet", "skygain.predictors.networks.paper_unet:PaperUNetPredictor")
PREDICTORS.register("paper-unet-mapblind", "skygain.predictors.networks.paper_unet:map_blind_unet")
PREDICTORS.register("unet", "skygain.predictors.networks.unet:UNetPredictor")
PREDICTORS.register(
    "residual-kriging", "skygain.predictors.kriging.residual:ResidualKrigingPredictor"
)
PREDICTORS.register(
    "fixed-rank-kriging", "skygain.predictors.kriging.fixed_rank:FixedRankKrigingPredictor"
)
PREDICTORS.register(
    "malmirchegini", "skygain.predictors.kriging.malmirchegini:MalmircheginiPredictor"
)
PREDICTORS.register(
    "random-forest", "skygain.predictors.rivals.random_forest:RandomForestPredictor"
)
PREDICTORS.register("tensor", "skygain.predictors.rivals.tensor:TensorPredictor")
PREDICTORS.register("sklearn-gp", "skygain.predictors.rivals.sklearn_gp:ScikitLearnPredictor")
PREDICTORS.register("pykrige", "skygain.predictors.rivals.pykrige:PyKrigePredictor")
PREDICTORS.register("gstools", "skygain.predictors.rivals.gstools:GSToolsPredictor")
PREDICTORS.register("gpytorch", "skygain.predictors.rivals.gpytorch:GPyTorchPredictor")


def create_predictor(name: str, **options: Any) -> Predictor:
    """The predictor called ``name``; an unknown name is an error that lists the known ones."""
    return PREDICTORS.create(name, **options)
