"""Explorer of the page on explorers: five particles, their weights, and the exact posterior."""

import numpy as np

from pfedu.explorers import Explorer, Puzzle, Seed, Shown, Slider
from pfedu.explorers.controls import geometric
from pfedu.figures.style import COLORS
from pfedu.gaussian import log_density
from pfedu.weights import effective_sample_size, normalize

STATES = np.linspace(-5, 5, 251)


def build(axes):
    """Draw what stays; return the artists that move."""
    ax, c = axes["weights"], COLORS
    ax.set(xlim=(-5, 5), ylim=(0, 1.15), xlabel="state", ylabel="weight, or density / peak")
    artists = {
        "likelihood": ax.plot([], [], ":", color=c["measurement"], label="likelihood")[0],
        "exact": ax.plot([], [], "--", color=c["exact"], label="exact posterior")[0],
        "sticks": ax.vlines([], [], [], color=c["particles"], lw=2),
        "tops": ax.plot([], [], "o", color=c["particles"], label="five particles")[0],
    }
    ax.legend(ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1), handlelength=1.6)
    return artists


def update(artists, axes, y, r, particles):
    """Weigh the particles and give the artists their data."""
    x = np.random.default_rng(particles).standard_normal(5)  # from the prior N(0, 1)
    log_w, _ = normalize(log_density(y - x[:, None], 0.0, r))
    w, n_eff = np.exp(log_w), float(effective_sample_size(log_w))
    mean, exact, var = float(w @ x), y / (1 + r), r / (1 + r)
    artists["likelihood"].set_data(STATES, np.exp(-0.5 * (y - STATES) ** 2 / r))
    artists["exact"].set_data(STATES, np.exp(-0.5 * (STATES - exact) ** 2 / var))
    artists["sticks"].set_segments([[(a, 0), (a, b)] for a, b in zip(x, w, strict=True)])
    artists["tops"].set_data(x, w)
    numbers = {"N_eff": n_eff, "mean of the particles": mean, "exact mean": exact}
    words = f"With r = {r:g} five particles do the work of {n_eff:.1f}; "
    words += f"their mean is {mean:.2f}, the exact mean {exact:.2f}."
    return Shown(words, numbers)


EXPLORER = Explorer(
    title="The weights of five particles",
    controls=(
        Slider("y", "measurement y", tuple(i / 4 for i in range(-12, 13)), 1.0),
        Slider("r", "variance r of its noise", geometric(0.01, 10.0, 19), 1.0),
        Seed("particles", "new particles"),
    ),
    layouts={
        "wide": ((7.0, 3.2), [["weights"]]),
        "narrow": ((3.7, 3.2), [["weights"]]),
    },
    build=build,
    update=update,
    puzzles=(
        Puzzle("Keep r = 1 and the first five particles, and find a measurement for which one of them does nearly "
               "all the work: N_eff below 1.1.",
               lambda params, numbers: params["particles"] == params["r"] == 1 and numbers["N_eff"] < 1.1,
               {"y": -3.0}),
    ),
)  # fmt: skip
