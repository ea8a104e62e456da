"""Where truth comes from: ray launching, diffraction over the rooftops, their union, and random
fields.

`PROPAGATION` lists the models by name. Each is called as

    PROPAGATION.create(name, city=city, transmitters_m=..., altitudes_m=..., frequency_hz=5e9,
    seed=0)

and returns the gain in dB, ``[transmitter, altitude, row, col]`` (float32). ``union`` is what
surveys are simulated on; models of rays alone are -inf where no ray reached a cell. Nothing is
loaded before a model is asked for.
"""

from __future__ import annotations

__all__ = ["PROPAGATION", "RAYS_ALONE"]

import numpy as np
from numpy.typing import NDArray

from skygain.ground.registry import Registry

PROPAGATION: Registry[NDArray[np.float32]] = Registry("propagation model")
PROPAGATION.register("union", "skygain.propagation.truth:union")
PROPAGATION.register("launch", "skygain.propagation.launching.launch:launch")
PROPAGATION.register("launch-combined", "skygain.propagation.launching.launch:launch_combined")
PROPAGATION.register("raytrace", "skygain.propagation.sionna:raytrace")
PROPAGATION.register("over-rooftop", "skygain.propagation.diffraction:over_rooftop")
PROPAGATION.register("gudmundson", "skygain.propagation.gudmundson:gudmundson")

RAYS_ALONE = ("launch", "launch-combined", "raytrace")
"""models that leave cells without a gain, so that no survey can use them"""
