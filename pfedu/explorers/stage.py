"""Where an explorer is drawn: one figure, built once, redrawn by blitting.

What stays (axes, ticks, legends) is drawn once and kept as pixels; a change draws only the artists
that changed on top. Matplotlib itself says when that is not enough: it marks a figure stale when
something that is not animated changed, such as a limit or a title.
"""

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

_RC = {"font.size": 9.0, "axes.titlesize": 9.5, "legend.fontsize": 8.0, "legend.frameon": False}


class Stage:
    """The figure of one explorer in one layout.

    Parameters
    ----------
    explorer : Explorer
    layout : str
        ``"wide"`` or ``"narrow"``.
    dpi : float
        Pixels an inch.

    Examples
    --------
    >>> from pfedu.explorers import load
    >>> from pfedu.explorers.stage import Stage
    >>> explorer = load("sir")
    >>> pixels, shown = Stage(explorer, dpi=50).draw(explorer.defaults())
    >>> pixels.shape[-1], shown.sentence.startswith("Growth model")
    (4, True)
    """

    def __init__(self, explorer, layout="wide", dpi=150):
        size, mosaic = explorer.layouts[layout]
        self.explorer = explorer
        with matplotlib.rc_context(_RC):
            self.figure = Figure(figsize=size, dpi=dpi, layout="constrained")
            self.canvas = FigureCanvasAgg(self.figure)
            self.axes = self.figure.subplot_mosaic(mosaic)
            for ax in self.axes.values():
                ax.grid(alpha=0.3, lw=0.6)
                ax.spines[["top", "right"]].set_visible(False)
            self.artists = explorer.build(self.axes)
        self._moving = sorted(_flat(self.artists.values()), key=lambda artist: artist.zorder)
        for artist in self._moving:
            artist.set_animated(True)
        self._background = None
        self.draw(explorer.defaults())
        self.figure.set_layout_engine("none")  # laid out once, so that panels never jump

    def draw(self, params):
        """Draw the explorer at these parameters.

        Parameters
        ----------
        params : dict
            A value for each control.

        Returns
        -------
        pixels : ndarray of uint8, shape (height, width, 4)
            RGBA; a view that the next call overwrites.
        shown : Shown
        """
        shown = self.explorer.update(self.artists, self.axes, **params)
        if self._background is None or self.figure.stale:
            self.canvas.draw()
            self._background = self.canvas.copy_from_bbox(self.figure.bbox)
        self.canvas.restore_region(self._background)
        for artist in self._moving:
            artist.axes.draw_artist(artist)
        return np.asarray(self.canvas.buffer_rgba()), shown


def _flat(artists):
    for artist in artists:
        if isinstance(artist, list | tuple):
            yield from _flat(artist)
        else:
            yield artist
