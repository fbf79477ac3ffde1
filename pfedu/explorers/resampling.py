"""Explorer of chapter 4: weights in, copies out, and how far the copies of each scheme scatter."""

from functools import lru_cache

import numpy as np
from matplotlib.ticker import MaxNLocator

from pfedu.explorers.controls import Choice, Seed, Slider
from pfedu.explorers.explorer import Explorer, Puzzle, Shown
from pfedu.figures.style import COLORS
from pfedu.resampling import SCHEMES

POINTS = 40_000  # random points behind every measured scatter, but no more than 1000 resamplings
NUMBERED = 12  # up to so many particles their stretches are numbered
FLOOR = 0.004  # where a ratio of zero is put on the logarithmic axis
NAMES = tuple(SCHEMES)
LOOKS = {"multinomial": ("third", "o"), "residual": ("accent", "s"), "stratified": ("second", "^"),
         "systematic": ("particles", "D")}  # fmt: skip
ORDERS = ("shuffled", "sorted by state", "alternating")

CONTROLS = (
    Choice("scheme", "resampling scheme", NAMES, "systematic"),
    Choice("order", "order of the particles", ORDERS, "shuffled"),
    Slider(
        "sharpness", "sharpness of the likelihood, 1/r", (0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0), 2.0
    ),
    Slider("N", "particles N", (4, 6, 8, 10, 12, 16, 20, 24, 32, 40, 48, 64), 8, drawn=12),
    Slider("size", "copies drawn, per particle", (0.5, 1.0, 1.5, 2.0, 3.0, 4.0), 1.0),
    Seed("draw", "draw again", drawn=8),
    Seed("particles", "new particles", drawn=4),
)


@lru_cache(maxsize=32)
def _cloud(order, sharpness, N, particles):
    """States and weights: standard normal states seen at y = 1, or -1 and 1 by turns."""
    if order == "alternating":
        x = np.where(np.arange(N) % 2, 1.0, -1.0)
        log_w = sharpness * x / 2
    else:
        x = np.random.default_rng([particles, 4]).standard_normal(64)[:N]
        x = np.sort(x) if order == "sorted by state" else x
        log_w = -sharpness * (x - 1.0) ** 2 / 2
    w = np.exp(log_w - log_w.max())
    return x, w / w.sum()


def _independent(m, p):
    """Covariance of the counts of m independent draws with probabilities p."""
    return m * (np.diag(p) - np.outer(p, p))


def _residual(w, size):
    whole = np.floor(size * w + 1e-9)
    left, fraction = size - whole.sum(), np.maximum(size * w - whole, 0.0)
    return _independent(left, fraction / left) if left else np.zeros((w.size, w.size))


def _stratified(w, size):
    ends = size * np.append(0.0, np.cumsum(w))
    share = np.diff(np.clip(ends - np.arange(size)[:, None], 0.0, 1.0), axis=1)  # (cells, particles)
    return np.diag(share.sum(axis=0)) - share.T @ share


def _systematic(w, size):
    ends = size * np.append(0.0, np.cumsum(w))
    ends = np.where(np.abs(ends - np.round(ends)) < 1e-9, np.round(ends), ends)
    cuts = np.unique(np.append(ends % 1.0, [0.0, 1.0]))  # the offsets at which a count changes
    counts = np.diff(np.ceil(ends - (cuts[1:, None] + cuts[:-1, None]) / 2), axis=1)  # (offsets, particles)
    d, p = counts - size * w, np.diff(cuts)
    return (d * p[:, None]).T @ d


EXACT = {"multinomial": lambda w, size: _independent(size, w), "residual": _residual, "stratified": _stratified,
         "systematic": _systematic}  # fmt: skip


def _draws(size):
    return min(1000, POINTS // size)


@lru_cache(maxsize=32)
def _scatter(order, sharpness, N, size, draw, particles):
    """Of each scheme: variance of every count and sd of the mean, exact and measured, and the sd's standard error."""
    x, w = _cloud(order, sharpness, N, particles)
    draws, out = _draws(size), {}
    batch = np.broadcast_to(w, (draws, N))
    for name, pick in SCHEMES.items():
        picked = pick(batch, np.random.default_rng([draw, 5]), size)
        counts = np.bincount((picked + N * np.arange(draws)[:, None]).ravel(), minlength=N * draws).reshape(draws, N)
        d = counts - size * w
        cov = EXACT[name](w, size)
        square = (d @ x / size) ** 2
        exact = np.sqrt(max(x @ cov @ x, 0.0)) / size
        sd = np.sqrt(square.mean())
        sd_se = square.std() / np.sqrt(draws) / (2 * sd) if sd > 1e-9 else 0.0
        out[name] = np.diag(cov), (d**2).mean(axis=0), exact if exact > 1e-9 else 0.0, sd if sd > 1e-9 else 0.0, sd_se
    return out


def _points(scheme, w, size, draw):
    """Where on the unit interval the points of one resampling stand, and the particles they pick."""
    u, picked = np.random.default_rng(draw).random(size), SCHEMES[scheme](w, np.random.default_rng(draw), size)
    if scheme == "multinomial":
        return np.sort(u), picked
    if scheme == "stratified":
        return (np.arange(size) + u) / size, picked
    if scheme == "systematic":
        return (np.arange(size) + u[0]) / size, picked
    whole, starts = np.floor(size * w + 1e-9).astype(int), np.cumsum(w) - w
    sure = np.concatenate([starts[i] + (np.arange(n) + 0.5) / size for i, n in enumerate(whole)])
    left, fraction = size - whole.sum(), np.maximum(size * w - whole, 0.0)  # the rest: independent, on the fractions
    ends = np.cumsum(fraction)
    free = u[:left] * ends[-1]
    i = np.minimum(np.searchsorted(ends, free, side="right"), w.size - 1)
    return np.sort(np.append(sure, starts[i] + (whole[i] + free - (ends - fraction)[i]) / size)), picked


def build(axes):
    """Draw what stays; return the artists that move."""
    artists = _build_comb(axes["comb"]) | _build_variance(axes["variance"]) | _build_mean(axes["mean"])
    ax, wide = axes["copies"], axes["comb"].figure.get_figwidth() > 5
    box = dict(color=COLORS["light"], alpha=0.6, lw=0, label="expected, size × w")
    artists["expected"] = ax.fill_between([0, 1], 0, 1, **box)
    artists["drawn"] = ax.plot([], [], "o", color=COLORS["particles"], ms=4, label="this draw")[0]
    ax.set(xlabel="particle", title="Copies")
    for side in (ax.xaxis, ax.yaxis):
        side.set_major_locator(MaxNLocator(5, integer=True))
    for ax, columns in ((axes["copies"], 1), (axes["variance"], 2), (axes["mean"], 1)):
        columns = columns if wide else 2
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.3), ncols=columns, handlelength=1.1, columnspacing=0.8)
    return artists


def _build_comb(ax):
    ink = COLORS["truth"]
    hatched = dict(color=COLORS["accent"], alpha=0.55, lw=0, hatch="//", edgecolor="white")
    artists = {
        "odd": ax.fill_between([0, 1], 0, 1, **hatched),
        "even": ax.fill_between([0, 1], 0, 1, color=COLORS["light"], alpha=0.6, lw=0),
        "cells": ax.vlines([0, 1], 0.62, 0.95, color=COLORS["measurement"], lw=0.8, ls=":"),
        "whole": ax.plot([], [], color=COLORS["exact"], lw=3, solid_capstyle="butt")[0],
        "stems": ax.vlines([0, 1], 0.5, 0.9, color=ink, lw=1.0),
        "heads": ax.plot([], [], "v", color=ink, ms=4)[0],
        "spine": ax.plot([], [], color=ink, lw=2.5)[0],
    }
    look = dict(ha="center", va="center", fontsize=8, bbox=dict(fc="white", ec="none", pad=1.0))
    for i in range(NUMBERED):
        artists[f"number {i + 1}"] = ax.text(0, 0.25, "", **look)
    ax.set(xlim=(0, 1), ylim=(0, 1.05), yticks=[], xlabel="cumulative weight", title="Points on the stretches")
    return artists


def _build_variance(ax):
    artists = {
        name: ax.plot([], [], marker, color=COLORS[color], ms=4, mec="none", alpha=0.85, label=name)[0]
        for name, (color, marker) in LOOKS.items()
    }
    artists["parabola"] = ax.plot([], [], color=COLORS["third"], lw=1)[0]
    artists["scallops"] = ax.plot([], [], color=COLORS["particles"], lw=1)[0]
    artists["measured"] = ax.plot([], [], "x", color=COLORS["truth"], ms=6, mew=1.2, label="measured")[0]
    ax.set(xlabel="expected copies", title="Variance of each count")
    ax.xaxis.set_major_locator(MaxNLocator(5, integer=True))
    return artists


def _build_mean(ax):
    mine = COLORS["particles"]
    artists = {
        "row": ax.plot([FLOOR / 10, 100], [0, 0], color=COLORS["accent"], alpha=0.35, lw=16)[0],
        "bars": ax.plot([], [], color=mine, lw=1.4)[0],
        "sd": ax.plot([], [], "o", color=mine, ms=4.5, label="measured, ± 2 s.e.")[0],
        "sd exact": ax.plot([], [], "|", color=COLORS["exact"], ms=13, mew=2.2, label="exact")[0],
    }
    ax.axvline(1, color=COLORS["measurement"], lw=0.8)
    ax.set(xscale="log", xlim=(FLOOR / 1.4, 12), ylim=(3.6, -0.6), xlabel="relative to multinomial")
    ax.set_xticks([0.01, 0.1, 1, 10], ["0.01", "0.1", "1", "10"])
    ax.set_yticks(range(len(NAMES)), NAMES)
    ax.set_title("Scatter of the mean (sd)")
    return artists


def update(artists, axes, scheme, order, sharpness, N, size, draw, particles):
    """Resample once to look at, and many times to measure."""
    size = round(size * N)
    _, w = _cloud(order, sharpness, N, particles)
    points, picked = _points(scheme, w, size, draw)
    scatter = _scatter(order, sharpness, N, size, draw, particles)
    _show_comb(artists, scheme, w, size, points)
    _show_copies(artists, axes["copies"], w, size, picked)
    _show_variance(artists, axes["variance"], scheme, w, size, scatter)
    _show_mean(artists, scheme, scatter)
    return _say(scheme, w, size, picked, scatter)


def _show_comb(artists, scheme, w, size, points):
    ends = np.cumsum(w)
    starts = ends - w
    boxes = [np.array([[a, 0.0], [b, 0.0], [b, 0.5], [a, 0.5]]) for a, b in zip(starts, ends, strict=True)]
    artists["odd"].set_verts(boxes[::2])
    artists["even"].set_verts(boxes[1::2])
    for i in range(NUMBERED):
        shown = i < w.size <= NUMBERED and w[i] > 0.03
        artists[f"number {i + 1}"].set(text=str(i + 1), visible=shown, x=(starts[i] + ends[i]) / 2 if shown else 0.0)
    heights = {"multinomial": 0.9, "residual": 0.9, "stratified": 0.9, "systematic": 0.97}
    artists["stems"].set_segments([[(p, 0.5), (p, heights[scheme])] for p in points])
    artists["heads"].set_data(points, np.full(points.size, 0.53))
    artists["cells"].set_segments([[(p, 0.5), (p, 1.03)] for p in np.arange(size + 1) / size])
    artists["cells"].set_visible(scheme in ("stratified", "systematic"))
    artists["spine"].set_data(*(([points[0], points[-1]], [0.97, 0.97]) if scheme == "systematic" else ([], [])))
    whole = np.floor(size * w + 1e-9) / size if scheme == "residual" else 0 * w
    gap = np.full(w.size, np.nan)
    artists["whole"].set_data(np.c_[starts, starts + np.where(whole > 0, whole, np.nan), gap].ravel(),
                              np.full(3 * w.size, 0.02))  # fmt: skip


def _show_copies(artists, ax, w, size, picked):
    counts = np.bincount(picked, minlength=w.size)
    number = np.arange(1, w.size + 1)
    limits = (0.4, w.size + 0.6), (0, np.ceil((size * w).max()) + 2.2)
    if (ax.get_xlim(), ax.get_ylim()) != limits:
        ax.set(xlim=limits[0], ylim=limits[1])
    artists["expected"].set_verts([[(i - 0.4, 0), (i + 0.4, 0), (i + 0.4, e), (i - 0.4, e)]
                                   for i, e in zip(number, size * w, strict=True)])  # fmt: skip
    artists["drawn"].set_data(number, counts)


def _show_variance(artists, ax, scheme, w, size, scatter):
    reach = max(2.0, np.ceil((size * w).max() + 0.2))
    limits = (-0.05 * reach, reach), (-0.06, 1.15 * max(0.5, max(exact.max() for exact, *_ in scatter.values())))
    if (ax.get_xlim(), ax.get_ylim()) != limits:
        ax.set(xlim=limits[0], ylim=limits[1])
    copies = np.linspace(0, min(reach, size), 401)
    artists["parabola"].set_data(copies, copies * (1 - copies / size))
    artists["scallops"].set_data(copies, (copies % 1) * (1 - copies % 1))
    for name, (exact, *_) in scatter.items():
        artists[name].set_data(size * w, exact)
    artists["measured"].set_data(size * w, scatter[scheme][1])


def _show_mean(artists, scheme, scatter):
    one = scatter["multinomial"][2]
    rows = np.arange(len(NAMES))
    exact, sd, se = (np.array([scatter[name][i] for name in NAMES]) / one for i in (2, 3, 4))
    artists["row"].set_ydata([NAMES.index(scheme)] * 2)
    artists["sd exact"].set_data(np.maximum(exact, FLOOR), rows)
    artists["sd"].set_data(np.maximum(sd, FLOOR), rows)
    low, high = np.maximum(sd - 2 * se, FLOOR), np.maximum(sd + 2 * se, FLOOR)
    artists["bars"].set_data(np.c_[low, high, np.full(4, np.nan)].ravel(), np.repeat(rows, 3))


def _say(scheme, w, size, picked, scatter):
    variance, _, exact, sd, se = scatter[scheme]
    one = scatter["multinomial"]
    kept, n_eff = np.unique(picked).size, 1 / np.sum(w**2)
    numbers = {"N_eff": n_eff, "particles kept in this draw": kept,
               "expected copies of the heaviest particle": size * w.max(),
               "its copies in this draw": int(np.sum(picked == w.argmax()))}  # fmt: skip
    for name, row in scatter.items():
        numbers[f"average variance of a count, {name}"] = float(row[0].mean())
    for name, row in scatter.items():
        numbers[f"sd of the mean, {name}, exact"] = float(row[2])
        numbers[f"sd of the mean, {name}, measured"] = float(row[3])
    beside = ("" if scheme == "multinomial" else f", {exact / one[2]:.2g} times that of multinomial resampling"
              if exact else ", for every count is certain")  # fmt: skip
    sentence = (
        f"{scheme.capitalize()} resampling of {w.size} particles (N_eff = {n_eff:.1f}) to {size} copies: "
        f"this draw keeps {kept} of them. A count has a variance of {variance.mean():.3f} on average "
        f"(multinomial {one[0].mean():.3f}). Resampling moves the mean by a standard deviation of {exact:.4f}"
        f"{beside}; measured over {_draws(size)} draws: {sd:.4f} ± {se:.4f}."
    )
    return Shown(sentence, numbers)


def _comb_not_fooled(params, numbers):
    """Whether the comb moves the mean of alternating, unequal particles by less than a third of multinomial's."""
    if params["order"] != "alternating" or params["N"] < 8 or params["sharpness"] == 0:
        return False
    return numbers["sd of the mean, systematic, exact"] < numbers["sd of the mean, multinomial, exact"] / 3


def _nobody_lost(params, numbers):
    """Whether every draw of the scheme keeps every particle, although the weights are far from equal."""
    _, w = _cloud(*(params[name] for name in ("order", "sharpness", "N", "particles")))
    size, scheme = round(params["size"] * w.size), params["scheme"]
    ends = size * np.append(0.0, np.cumsum(w))
    cells = np.floor(ends[1:] + 1e-9) - np.ceil(ends[:-1] - 1e-9)  # whole cells that a stretch covers
    sure = {"multinomial": 0 * w, "residual": size * w, "systematic": size * w, "stratified": cells}[scheme]
    return numbers["N_eff"] < 0.75 * w.size and sure.min() >= 1 - 1e-9


PUZZLES = (
    Puzzle(
        "Alternating particles fool the comb. Take 8 of them or more, with unequal weights (sharpness above 0), and "
        "find a position at which systematic resampling moves the mean by less than a third of what multinomial "
        "resampling does (the exact sd of the mean) all the same.",
        _comb_not_fooled,
        {"order": "alternating", "sharpness": 0.5, "size": 4.0},
    ),
    Puzzle(
        "Make the weights so uneven that N_eff is below three quarters of N, and yet no draw of the chosen scheme, "
        "however unlucky, can lose a particle.",
        _nobody_lost,
        {"order": "alternating", "sharpness": 1.5, "size": 4.0},
    ),
)


EXPLORER = Explorer(
    title="Weights in, copies out",
    controls=CONTROLS,
    layouts={
        "wide": ((7.6, 4.9), [["comb", "comb", "comb"], ["copies", "variance", "mean"]]),
        "narrow": ((3.7, 8.2), [["comb"], ["copies"], ["variance"], ["mean"]]),
    },
    build=build,
    update=update,
    also=(
        *({"order": "alternating", "N": n} for n in (4, 16, 32, 64)),
        *({"order": "alternating", "N": 64, "scheme": name} for name in NAMES),
        *({"order": "sorted by state", "N": n} for n in (16, 32, 64)),
        *({"scheme": name, "draw": draw} for name in NAMES if name != "systematic" for draw in (2, 3, 4)),
        *({"sharpness": 0.0, "scheme": name} for name in NAMES),
        {"order": "alternating", "draw": 3},
    ),
    puzzles=PUZZLES,
)
