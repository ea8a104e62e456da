"""What shows itself in a notebook."""

from __future__ import annotations

__all__ = ["Shown", "agg_figure"]

import base64
import html
import io
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure


class Shown:
    """Base of maps and results: `to_xarray` is all that a subclass has to bring."""

    def to_xarray(self) -> xr.Dataset:
        """The maps, with their units; two-dimensional variables are what `plot` draws."""
        raise NotImplementedError

    def plot(self) -> Figure:
        """The estimate and its uncertainty side by side."""
        maps = self.to_xarray()
        figure = agg_figure((10.0, 4.2))
        panels = figure.subplots(1, 2)
        for panel, name, colours in zip(
            panels, ("mean_db", "std_db"), ("viridis", "magma"), strict=True
        ):
            values = maps[name]
            across, along = (values[each].to_numpy() for each in values.dims[::-1])
            image = panel.pcolormesh(across, along, values, cmap=colours, shading="nearest")
            panel.set(title=values.attrs["long_name"], aspect="equal")
            panel.set(xlabel=str(values.dims[1]), ylabel=str(values.dims[0]))
            figure.colorbar(image, ax=panel, label="dB")
        return figure

    def _repr_html_(self) -> str:
        memory = io.BytesIO()
        self.plot().savefig(memory, format="png", dpi=80)
        picture = base64.b64encode(memory.getvalue()).decode("ascii")
        text = html.escape(repr(self))
        return f'<pre>{text}</pre><img alt="maps" src="data:image/png;base64,{picture}">'


def agg_figure(size: tuple[float, float]) -> Figure:
    """A Matplotlib figure of its own, which leaves a caller's figures and settings alone."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure
