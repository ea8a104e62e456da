"""What a city file holds and how it would be read, without a flight."""

from __future__ import annotations

__all__ = ["holdings", "inspected", "picture", "terminal_map"]

import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from skygain.cities.opening import read_city
from skygain.cities.raster import SUFFIXES as RASTERS
from skygain.cities.reading import CityOptions, Reading, existing_file
from skygain.cities.vector import is_vector, open_layer
from skygain.city import City
from skygain.frames import vertical_datum
from skygain.ground.errors import InputError, MissingExtraError, require

_SHADES = " .:-=+*#%@"
"""from open ground to the highest roof"""


def inspected(
    spec: str | Path, options: CityOptions | None = None, **given: Any
) -> tuple[list[str], Reading | None]:
    """What the file holds, how it is read with these options, and the reading, if it can be.

    Raises:
        InputError: there is no such file, or it is not even of a format that is read.
    """
    options = replace(options or CityOptions(), **given)
    path = Path(str(spec))
    lines = list(holdings(path)) if path.suffix else []
    try:
        reading = read_city(spec, options)
    except MissingExtraError:
        raise  # nothing is wrong with the file
    except InputError as error:
        if not lines:
            raise
        return [*lines, f"it cannot be read as it stands: {error}"], None
    city = reading.city
    lines += [f"read as {city.name}: {reading.place}"]
    lines += [f"  {note}" for note in reading.notes]
    built = city.height_m > 0
    share = f"{built.mean():.1%} of the cells built"
    if built.any():
        low, middle, high = np.quantile(city.height_m[built], [0.0, 0.5, 1.0])
        share += f", {low:.1f} to {high:.1f} m high, half below {middle:.1f} m"
    lines.append(f"  {len(city.buildings) or 'no'} polygons; {share}")
    if city.ground_m.any():
        low, high = float(city.ground_m.min()), float(city.ground_m.max())
        lines.append(f"  ground {low:.1f} to {high:.1f} m above {city.ground_datum or 'its zero'}")
    return lines, reading


def holdings(path: Path) -> Iterator[str]:
    """A line for each layer, band or column group of a file; nothing for formats that are read as
    a whole.

    Raises:
        InputError: the file is not there.
    """
    existing_file(path)
    yield f"{path.name}: {path.stat().st_size:,} bytes"
    try:
        if path.suffix.lower() in RASTERS:
            yield from _bands(path)
        elif is_vector(path):
            yield from _layers(path)
    except MissingExtraError:
        raise
    except InputError as error:
        yield f"  {error}"
    # GDAL answers foreign bytes with a dozen kinds of error; here they are only told
    except Exception as error:
        yield f"  not readable: {' '.join(str(error).split())[:160]}"


def _bands(path: Path) -> Iterator[str]:
    rasterio = require("rasterio", "geo")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        with rasterio.open(path, driver="GTiff") as source:
            crs = source.crs.to_string()[:60] if source.crs else "no coordinate reference system"
            datum = vertical_datum(source.crs.to_wkt() if source.crs else None)
            above = f", heights above {datum[0]} in {datum[1]}" if datum else ""
            size = f"{source.width} x {source.height} pixels of {abs(source.transform.a):.6g}"
            yield f"  GeoTIFF, {size}, {crs}{above}"
            small = (min(source.height, 1000), min(source.width, 1000))
            for i in range(1, source.count + 1):
                values = source.read(i, masked=True, out_shape=small).compressed()
                values = values[np.isfinite(values)]
                span = f"{values.min():g} to {values.max():g}" if values.size else "no values"
                about = [source.dtypes[i - 1], span, f"nodata {source.nodatavals[i - 1]}"]
                about += [source.units[i - 1] or "no unit", source.descriptions[i - 1] or ""]
                yield f"  band {i}: {', '.join(part for part in about if part)}"


def _layers(path: Path) -> Iterator[str]:
    pyogrio = require("pyogrio", "geo")
    try:
        layers = [(str(name), str(kind)) for name, kind in pyogrio.list_layers(path)]
    except Exception:  # a format that GDAL does not know: read as a whole
        layer = open_layer(path, crs="local")
        extent = layer.extent()
        shown = "nothing" if extent is None else ", ".join(f"{v:.6g}" for v in extent)
        yield f"  one layer over [{shown}], columns {', '.join(layer.fields)[:200] or 'unknown'}"
        return
    for name, kind in layers:
        info = pyogrio.read_info(path, layer=name)
        features = info["features"] if info["features"] >= 0 else "some"
        columns = ", ".join(str(field) for field in info["fields"])[:200] or "none"
        crs = str(info["crs"] or "no coordinate reference system")[:60]
        yield f"  layer {name} ({info['driver']}): {features} of {kind}, {crs}; columns {columns}"


def terminal_map(city: City, width: int = 72) -> str:
    """The roofs as characters, north up: the darker, the higher; a character is twice as high as
    wide.

    >>> from skygain.cities import open_city
    >>> print(terminal_map(open_city("7"), 8).splitlines()[0])
    +--------+
    """
    rows, cols = city.grid.shape
    across = max(1, min(width, cols))
    step = cols / across
    down = max(1, round(rows / (2 * step)))
    top = float(city.height_m.max()) or 1.0
    lines = []
    for i in reversed(range(down)):
        south, north = (
            int(i * rows / down),
            max(int((i + 1) * rows / down), int(i * rows / down) + 1),
        )
        strip = city.height_m[south:north].max(axis=0)
        cells = [
            strip[int(j * step) : max(int((j + 1) * step), int(j * step) + 1)].max()
            for j in range(across)
        ]
        shades = [0 if h <= 0 else max(1, int(h / top * (len(_SHADES) - 1))) for h in cells]
        lines.append("|" + "".join(_SHADES[s] for s in shades) + "|")
    edge = "+" + "-" * across + "+"
    return "\n".join([edge, *lines, edge])


def picture(city: City, path: str | Path) -> None:
    """A PNG of the roofs, over the ground's contours where it is not level.

    Raises:
        InputError: the file cannot be written.
    """
    from matplotlib.figure import Figure

    west, south, east, north = city.grid.bounds_m
    figure = Figure(figsize=(7, 7), layout="constrained")
    axes = figure.add_subplot()
    shown = np.ma.masked_less_equal(city.height_m, 0)
    image = axes.imshow(shown, origin="lower", extent=(west, east, south, north), cmap="viridis")
    figure.colorbar(image, ax=axes, label="height above ground in m", shrink=0.8)
    if not city.is_level:
        lines = axes.contour(
            city.grid.x_m, city.grid.y_m, city.ground_m, colors="0.5", linewidths=0.6
        )
        axes.clabel(lines, fontsize=6)
    axes.set(title=city.name, xlabel="x in m", ylabel="y in m")
    try:
        figure.savefig(path, dpi=130, format="png")
    except OSError as error:
        raise InputError(
            f"cannot write {str(path)!r} ({error.strerror}); choose a folder that exists"
        ) from error
