"""GSTools: simple Kriging if the mean is given, else ordinary Kriging with a fitted variogram."""

from __future__ import annotations

__all__ = ["GSToolsPredictor"]

import warnings
from dataclasses import dataclass
from typing import ClassVar

from skygain.fields.offsets import ExponentialKernel
from skygain.predictors.rivals.base import Answer, Array, RivalPredictor


@dataclass(frozen=True)
class GSToolsPredictor(RivalPredictor):
    """See the module."""

    package: ClassVar[str] = "gstools"

    def fitted(
        self, xy_m: Array, gain_db: Array, noise_db2: Array, told: ExponentialKernel | None
    ) -> Answer:
        import gstools as gs

        if told is None:
            model = gs.Exponential(dim=2)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # a flat variogram says nothing of its range
                model.fit_variogram(*gs.vario_estimate(xy_m.T, gain_db))
        else:
            model = gs.Exponential(
                dim=2, var=told.sill_db2, len_scale=told.range_m, nugget=told.nugget_db2
            )
        noise = noise_db2 + model.nugget  # both differ from reading to reading
        if self.parameters is None:
            krige = gs.krige.Ordinary(model, xy_m.T, gain_db, cond_err=noise)
        else:
            krige = gs.krige.Simple(model, xy_m.T, gain_db, mean=0.0, cond_err=noise)

        def answer(xy: Array) -> tuple[Array, Array]:
            return krige(xy.T, mesh_type="unstructured", return_var=True, store=False)

        return answer
