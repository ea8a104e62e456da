"""Predictors by name."""

from __future__ import annotations

__all__ = ["PREDICTORS", "Belief", "Predictor", "create_predictor"]

from typing import Any

from skygain.predictors.base import Belief, Predictor
from skygain.registry import Registry

PREDICTORS: Registry[Predictor] = Registry("predictor")
PREDICTORS.register("kriging", "skygain.predictors.kriging:KrigingPredictor")
PREDICTORS.register("kriging-blind", "skygain.predictors.kriging:blind_kriging")
PREDICTORS.register("kriging-quadratic", "skygain.predictors.kriging:quadratic_kriging")
PREDICTORS.register("kriging-inferred", "skygain.predictors.kriging:inferred_kriging")
PREDICTORS.register("local-kriging", "skygain.predictors.local_kriging:LocalKrigingPredictor")
PREDICTORS.register("gids", "skygain.predictors.gids:GidsPredictor")
PREDICTORS.register("thin-plate", "skygain.predictors.thin_plate:ThinPlatePredictor")
PREDICTORS.register("idw", "skygain.predictors.idw:IdwPredictor")
PREDICTORS.register("knn", "skygain.predictors.knn:KnnPredictor")
PREDICTORS.register("operator", "skygain.predictors.operator:OperatorPredictor")
PREDICTORS.register("paper-unet", "skygain.predictors.paper_unet:PaperUNetPredictor")
PREDICTORS.register("paper-unet-mapblind", "skygain.predictors.paper_unet:map_blind_unet")
PREDICTORS.register("unet", "skygain.predictors.unet:UNetPredictor")
PREDICTORS.register("residual-kriging", "skygain.predictors.residual_kriging:ResidualKrigingPredictor")


def create_predictor(name: str, **options: Any) -> Predictor:
    """The predictor called ``name``; an unknown name is an error that lists the known ones."""
    return PREDICTORS.create(name, **options)
