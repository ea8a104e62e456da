"""Maps as a cloud-optimised GeoTIFF, with a style that QGIS finds beside it.

QGIS takes a file of the same name that ends in ``.qml`` for the style of a raster.
"""

from __future__ import annotations

__all__ = ["Band", "write_geotiff", "write_style"]

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from skygain.grid import Grid
from skygain.ground.errors import MissingExtraError, install_command, require
from skygain.ground.files import atomic_write

Band = tuple[str, NDArray[Any], str]
"""name, values ``[row, col]`` with NaN for no data, unit"""
_COLOURS = 11


def write_geotiff(
    path: Path, grid: Grid, bands: Sequence[Band], tags: Mapping[str, Any]
) -> str | None:
    """Write float32 bands, north up, NaN where there is no data, with overviews inside.

    Without a CRS the transform is in the metres of the map's own frame.

    Returns:
        A note when the geo extra is missing and nothing was written, else ``None``.
    """
    try:
        rasterio = require("rasterio", "geo")
    except MissingExtraError:
        return f"{path.name} was left out; to have it: {install_command('geo')}"
    from rasterio.io import MemoryFile
    from rasterio.shutil import copy

    west, _, _, north = grid.bounds_m
    side = grid.spacing_m
    profile = {
        "driver": "GTiff",
        "height": grid.shape[0],
        "width": grid.shape[1],
        "count": len(bands),
        "dtype": "float32",
        "nodata": np.nan,
        "crs": grid.crs,
        "transform": rasterio.Affine(side, 0.0, west, 0.0, -side, north),
    }
    # Made in memory: GDAL would put a side file next to the temporary name.
    with MemoryFile() as plain, MemoryFile() as memory:
        with plain.open(**profile) as raster:
            for number, (name, values, unit) in enumerate(bands, start=1):
                # row 0 is the south, a GeoTIFF begins in the north
                raster.write(np.flipud(values).astype(np.float32), number)
                raster.set_band_description(number, name)
                raster.set_band_unit(number, unit)
            raster.update_tags(**{key: str(value) for key, value in tags.items()})
        copy(plain.name, memory.name, driver="COG", compress="DEFLATE", predictor="YES")
        with atomic_write(path) as tmp:
            tmp.write_bytes(memory.read())
    return None


def write_style(path: Path, low: float, high: float, unit: str, colours: str = "viridis") -> None:
    """Write the QGIS style of a raster whose first band is drawn from ``low`` to ``high``, in the
    colours of the pictures."""
    import matplotlib
    from matplotlib.colors import to_hex

    scale = matplotlib.colormaps[colours]
    items = "\n".join(
        f'        <item alpha="255" color="{to_hex(scale(part))}" value="{value:.10g}" '
        f"label={quoteattr(f'{value:.0f} {unit}')}/>"
        for part, value in zip(
            np.linspace(0, 1, _COLOURS), np.linspace(low, high, _COLOURS), strict=True
        )
    )
    text = f"""<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.22" styleCategories="Symbology">
  <pipe>
    <rasterrenderer type="singlebandpseudocolor" band="1" opacity="1" alphaBand="-1"
        classificationMin="{low:.10g}" classificationMax="{high:.10g}">
      <rastershader>
        <colorrampshader colorRampType="INTERPOLATED" classificationMode="1" clip="0"
            minimumValue="{low:.10g}" maximumValue="{high:.10g}">
{items}
        </colorrampshader>
      </rastershader>
    </rasterrenderer>
  </pipe>
  <blendMode>0</blendMode>
</qgis>
"""
    with atomic_write(path) as tmp:
        tmp.write_text(text, encoding="utf-8")
