"""Matplotlib pictures of the book, one function a kind of picture; each draws into the axes it is given."""

from pfedu.figures.density import particle_histogram, plot_density
from pfedu.figures.style import COLORS, use_style
from pfedu.figures.track import plot_measurements, plot_track, plot_truth
from pfedu.figures.waterfall import plot_waterfall

__all__ = [
    "COLORS",
    "particle_histogram",
    "plot_density",
    "plot_measurements",
    "plot_track",
    "plot_truth",
    "plot_waterfall",
    "use_style",
]
