"""Where truth comes from: ray tracing, diffraction over the rooftops, their union, and random
fields.

`PROPAGATION` lists the models by name. Each is called as

    PROPAGATION.create(name, city=city, transmitters_m=..., altitudes_m=..., frequency_hz=5e9,
    seed=0)

and returns the gain in dB, ``[transmitter, altitude, row, col]`` (float32). ``union`` is what
surveys are simulated on; ``raytrace`` is -inf where no ray reached a cell. Nothing is loaded before
a model is asked for.
"""

from __future__ import annotations

__all__ = ["PROPAGATION"]

import numpy as np
from numpy.typing import NDArray

from skygain.ground.registry import Registry

PROPAGATION: Registry[NDArray[np.float32]] = Registry("propagation model")
PROPAGATION.register("raytrace", "skygain.propagation.models:raytrace")
PROPAGATION.register("over-rooftop", "skygain.propagation.models:over_rooftop")
PROPAGATION.register("union", "skygain.propagation.models:union")
PROPAGATION.register("gudmundson", "skygain.propagation.models:gudmundson")
