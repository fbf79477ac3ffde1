"""Explorer of chapter 9: how wide the kernel of a regularised particle filter should be."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from pfedu.explorers.controls import Choice, Seed, Slider
from pfedu.explorers.explorer import Explorer, Puzzle, Shown
from pfedu.figures.style import COLORS
from pfedu.filters.regularized import draw_kernel, optimal_bandwidth
from pfedu.resampling import systematic

CLOUDS = 40  # over which means are taken
PRIOR = 9.0  # variance of the Gaussian that particles are drawn from, mean 0
# The likelihood is a sum of Gaussians in the state: shares, means, variances. So the posterior is one as well.
LIKELIHOODS = {
    "one peak": ((1.0,), (1.0,), (0.49,)),
    "two peaks": ((0.55, 0.45), (-2.0, 2.0), (0.2, 0.2)),
    "skewed": ((0.4, 0.35, 0.25), (-1.6, -0.8, 0.8), (0.08, 0.3, 1.2)),
}
X = np.linspace(-8.0, 8.0, 2048, endpoint=False)  # bins of the Fourier transforms
DX = X[1] - X[0]
OMEGA = 2 * np.pi * np.fft.rfftfreq(X.size, DX)
FACTORS = (0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.85, 1.0, 1.2, 1.4, 1.7, 2.0)

CONTROLS = (
    Choice("target", "posterior", tuple(LIKELIHOODS), "two peaks"),
    Slider("factor", "bandwidth / the formula's", FACTORS, 1.0, drawn=14),
    Slider("N", "particles N", (50, 70, 100, 140, 200, 300, 500, 700, 1000, 1400, 2000), 200, drawn=6),
    Choice("kernel", "kernel", ("gaussian", "epanechnikov"), "gaussian"),
    Choice("shrink", "shrinkage", ("no", "yes"), "no"),
    Seed("particles", "new particles", drawn=5),
)


class _Posterior(NamedTuple):
    """A sum of Gaussians."""

    shares: np.ndarray
    means: np.ndarray
    variances: np.ndarray

    @property
    def moments(self):
        mean = self.shares @ self.means
        return mean, self.shares @ (self.variances + (self.means - mean) ** 2)

    def density(self, x):
        z = (x[:, None] - self.means) ** 2 / self.variances
        return np.exp(-0.5 * z) / np.sqrt(2 * np.pi * self.variances) @ self.shares

    def curvature(self):
        """Integral of the square of the second derivative."""
        z = (X[:, None] - self.means) / np.sqrt(self.variances)
        bend = (z * z - 1) * np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi) * self.variances**-1.5
        return np.sum((bend @ self.shares) ** 2) * DX


@lru_cache(maxsize=8)
def _posterior(target):
    """Prior times likelihood, completed squares."""
    c, mu, r = (np.array(values) for values in LIKELIHOODS[target])
    S = PRIOR + r
    shares = c * np.exp(-0.5 * mu * mu / S) / np.sqrt(S)
    return _Posterior(shares / shares.sum(), mu * PRIOR / S, r * PRIOR / S)


@lru_cache(maxsize=4)
def _draws(seed, clouds):
    """Particles of the prior and draws of both kernels, enough for the largest N; fewer are the first of them."""
    rng, most = np.random.default_rng([seed, 9]), CONTROLS[2].values[-1]
    x = np.sqrt(PRIOR) * rng.standard_normal((clouds, most))
    offsets = rng.integers(2**32, size=clouds)
    return x, offsets, {name: draw_kernel(name, (clouds, most, 1), rng)[..., 0] for name in CONTROLS[3].values}


@lru_cache(maxsize=24)
def _clouds(target, N, seed, clouds):
    """Weighted mean and sd of each cloud, its effective number, and the particles after resampling: (clouds, N)."""
    x, offsets, _ = _draws(seed, clouds)
    x, (c, mu, r) = x[:, :N], (np.array(values) for values in LIKELIHOODS[target])
    w = np.exp(-0.5 * (x[..., None] - mu) ** 2 / r) @ (c / np.sqrt(r))
    w = w / w.sum(axis=-1, keepdims=True)
    m = (w * x).sum(axis=-1)
    sd = np.sqrt((w * (x - m[:, None]) ** 2).sum(axis=-1))
    picked = np.array([systematic(row, np.random.default_rng(i)) for row, i in zip(w, offsets, strict=True)])
    return m, sd, 1 / (w * w).sum(axis=-1), np.take_along_axis(x, picked, axis=-1)


@lru_cache(maxsize=24)
def _spectra(target, N, kernel, shrink, seed, clouds):
    """Fourier transforms of the regularised densities, (factors, clouds, frequencies)."""
    m, sd, _, x = _clouds(target, N, seed, clouds)
    spectra, spikes = [], _bins(x)
    for factor in FACTORS:
        h, a = _width(N, kernel, factor, shrink)
        spikes = _bins(m[:, None] + a * (x - m[:, None])) if shrink == "yes" else spikes
        spectra.append(spikes * _transform(kernel, h * sd[:, None] * OMEGA))
    return np.array(spectra)


def _bins(x):
    """Fourier transform of the points, each in its bin: (clouds, frequencies)."""
    bins = np.clip(np.rint((x - X[0]) / DX).astype(int), 0, X.size - 1) + X.size * np.arange(len(x))[:, None]
    return np.fft.rfft(np.bincount(bins.ravel(), minlength=len(x) * X.size).reshape(-1, X.size) / (x.shape[1] * DX))


@lru_cache(maxsize=48)
def _errors(target, N, kernel, shrink, seed, clouds):
    """Integrated square error over the integral of the exact density's square: (factors, clouds)."""
    exact = _posterior(target).density(X)
    gap = _spectra(target, N, kernel, shrink, seed, clouds) - np.fft.rfft(exact)
    return 2 * np.sum(np.abs(gap[..., 1:]) ** 2, axis=-1) / X.size / np.sum(exact**2)  # Parseval; the masses agree


@lru_cache(maxsize=48)
def _ratios(target, N, kernel, shrink, seed, clouds):
    """Variance of the moved points over the exact one: (factors, clouds)."""
    _, sd, _, x = _clouds(target, N, seed, clouds)
    eps = sd[:, None] * _draws(seed, clouds)[2][kernel][:, :N]
    d, eps = x - x.mean(axis=-1, keepdims=True), eps - eps.mean(axis=-1, keepdims=True)
    dd, de, ee = ((u * v).mean(axis=-1) for u, v in ((d, d), (d, eps), (eps, eps)))
    h, a = (np.array(v)[:, None] for v in zip(*(_width(N, kernel, f, shrink) for f in FACTORS), strict=True))
    return (a * a * dd + 2 * a * h * de + h * h * ee) / _posterior(target).moments[1]


def _width(N, kernel, factor, shrink):
    """Bandwidth in standard deviations of the cloud, and by how much to draw the cloud together."""
    h = factor * optimal_bandwidth(N, 1, kernel)
    return h, np.sqrt(1 - _spread(kernel) * h * h) if shrink == "yes" else 1.0


def _spread(kernel):
    return 1.0 if kernel == "gaussian" else 0.2  # 1 / (n + 4)


def _transform(kernel, u):
    """Fourier transform of a kernel in one dimension."""
    if kernel == "gaussian":
        return np.exp(-0.5 * u * u)
    u = np.maximum(u, 1e-2)  # below, 1 - u²/10
    return 3 * (np.sin(u) - u * np.cos(u)) / u**3


def _theory(target, N, kernel):
    """What `_errors` should be on average for N independent draws, to leading order."""
    posterior, h = _posterior(target), np.array(FACTORS) * optimal_bandwidth(N, 1, kernel)
    h, square = h * np.sqrt(posterior.moments[1]), 0.5 / np.sqrt(np.pi) if kernel == "gaussian" else 0.6
    error = h**4 * _spread(kernel) ** 2 / 4 * posterior.curvature() + square / (N * h)
    return error / (np.sum(posterior.density(X) ** 2) * DX)


def build(axes):
    """Draw what stays; return the artists that move."""
    d, e, v = (axes[name] for name in ("density", "error", "variance"))
    blue, green, exact = COLORS["particles"], COLORS["second"], dict(color=COLORS["exact"], lw=1.6, ls="--")
    cloud = dict(color=COLORS["truth"], ls="", marker="s", ms=5)
    artists = {
        "moved": d.fill_between([0, 1], 0, 0, color=COLORS["light"], alpha=0.45, lw=0, label="moved points"),
        "smooth": d.plot([], [], color=blue, lw=1.8, label="regularised")[0],
        "exact": d.plot([], [], label="exact", **exact)[0],
        "comb": d.vlines([0], 0, 1, color=COLORS["truth"], lw=0.8, label="resampled (length: copies)"),
        "band": e.fill_between([0.1, 2], 1, 1, color=blue, alpha=0.2, lw=0, label=f"{CLOUDS} clouds, ± sd"),
        "theory": e.plot([], [], label="formula, not shrunk", **exact)[0],
        "mean": e.plot([], [], color=blue, lw=1.6, marker="o", ms=3, label="their mean")[0],
        "best": e.plot([], [], "v", color=green, ms=9, mfc="none", mew=1.6, label="least mean")[0],
        "here": e.plot([], [], label="cloud above", **cloud)[0],
        "at": e.axvline(1.0, color=COLORS["accent"], lw=5, alpha=0.4),
        "expected": v.plot([], [], label=r"$1 + h^2\sigma_K^2$", **exact)[0],
        "plain": v.plot([], [], color=blue, ls="", marker="o", ms=4, label="not shrunk")[0],
        "shrunk": v.plot([], [], color=green, ls="", marker="^", ms=4.5, mfc="none", label="shrunk")[0],
        "bars": v.vlines([1], 1, 1, color=COLORS["measurement"], lw=1),
        "ratio": v.plot([], [], label="cloud above", **cloud)[0],
        "at_v": v.axvline(1.0, color=COLORS["accent"], lw=5, alpha=0.4),
    }
    _label(d, e, v)
    return artists


def _label(d, e, v):
    wide = d.figure.get_figwidth() > 5
    d.set(xlim=(-5, 5), ylim=(-0.42, 1.75), yticks=[0, 0.5, 1, 1.5], xlabel="state", ylabel="density / exact peak")
    d.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4 if wide else 2, columnspacing=1.0, handlelength=2)
    for ax in (e, v):
        ax.set(xscale="log", xlim=(0.085, 2.35), xlabel="bandwidth / the formula's")
        ax.set_xticks([0.1, 0.2, 0.5, 1, 2], ["0.1", "0.2", "0.5", "1", "2"])
        ax.minorticks_off()
    v.axhline(1.0, color=COLORS["truth"], lw=0.8)
    e.set(
        yscale="log",
        ylim=(1e-3, 90.0),
        yticks=[1e-3, 1e-2, 1e-1, 1],
        ylabel="ISE / $\\int p^2$",
        title="Integrated square error",
    )
    v.set(ylim=(0.75, 2.35), ylabel="variance / exact", title="Variance of the moved points (± se)")
    e.legend(loc="upper right", ncols=2, columnspacing=0.8, handlelength=1.6, borderaxespad=0.1)
    v.legend(loc="upper left", ncols=1)


def update(artists, axes, target, factor, N, kernel, shrink, particles):
    """Take one cloud and the study of many, and give the artists their data."""
    at = FACTORS.index(factor)
    one, many = (target, N, kernel, shrink, particles, 1), (target, N, kernel, shrink, 0, CLOUDS)
    x = _clouds(target, N, particles, 1)[3][0]
    _show_density(artists, target, x, _spectra(*one)[at, 0], _moved(*one, at))
    errors, error = _errors(*many), _errors(*one)[at, 0]
    mean, sd = errors.mean(axis=1), errors.std(axis=1, ddof=1)
    low, high = np.maximum(mean - sd, 1e-4), mean + sd
    artists["band"].set_verts([np.c_[np.r_[FACTORS, FACTORS[::-1]], np.r_[low, high[::-1]]]])
    artists["mean"].set_data(FACTORS, mean)
    theory = _theory(target, N, kernel)
    artists["theory"].set_data(FACTORS, np.where(theory < 2.0, theory, np.nan))
    artists["best"].set_data([FACTORS[mean.argmin()]], [mean.min()])
    artists["here"].set_data([factor], [error])
    ratios = _show_variance(artists, one, many, at)
    for name in ("at", "at_v"):
        artists[name].set_xdata([factor, factor])
    return _say(one, factor, x, (error, mean, sd), ratios)


def _moved(target, N, kernel, shrink, seed, clouds, at):
    """The points of the first cloud after the kernel."""
    m, sd, _, x = _clouds(target, N, seed, clouds)
    h, a = _width(N, kernel, FACTORS[at], shrink)
    return m[0] + a * (x[0] - m[0]) + h * sd[0] * _draws(seed, clouds)[2][kernel][0, :N]


def _show_density(artists, target, x, spectrum, moved):
    exact = _posterior(target).density(X)
    top = exact.max()
    artists["exact"].set_data(X, exact / top)
    artists["smooth"].set_data(X, np.fft.irfft(spectrum) / top)
    edges = np.linspace(-5, 5, 61)
    heights = np.histogram(moved, bins=edges)[0] / (moved.size * (edges[1] - edges[0]) * top)
    outline = np.c_[np.repeat(edges, 2)[1:-1], np.repeat(heights, 2)]
    artists["moved"].set_verts([np.r_[outline, [[5, 0], [-5, 0]]]])
    points, copies = np.unique(x, return_counts=True)
    ends = -0.06 - 0.33 * copies / copies.max()
    artists["comb"].set_segments(np.stack([np.c_[points, 0 * ends - 0.06], np.c_[points, ends]], axis=1))


def _show_variance(artists, one, many, at):
    """Give the lower right panel its data; return the ratio of the one cloud, the mean of many and its expectation."""
    target, N, kernel, shrink, *_ = one
    both = {word: _ratios(target, N, kernel, word, 0, CLOUDS) for word in CONTROLS[4].values}
    segments = []
    for word, name in (("no", "plain"), ("yes", "shrunk")):
        mean, se = both[word].mean(axis=1), both[word].std(axis=1, ddof=1) / np.sqrt(CLOUDS)
        artists[name].set_data(FACTORS, mean)
        segments += [[(f, m - s), (f, m + s)] for f, m, s in zip(FACTORS, mean, se, strict=True)]
    artists["bars"].set_segments(segments)
    expected = 1 + _spread(kernel) * (np.array(FACTORS) * optimal_bandwidth(N, 1, kernel)) ** 2
    artists["expected"].set_data(FACTORS, expected)
    here = _ratios(*one)[at, 0]
    artists["ratio"].set_data([FACTORS[at]], [here])
    return here, both[shrink][at].mean(), expected[at] if shrink == "no" else 1.0


def _say(one, factor, x, errors, ratios):
    target, N, kernel, shrink, seed, _ = one
    (error, mean, sd), (ratio, mean_ratio, expected) = errors, ratios
    at, best, h = FACTORS.index(factor), int(mean.argmin()), factor * optimal_bandwidth(N, 1, kernel)
    numbers = {
        "different points after resampling": len(np.unique(x)),
        "N_eff before it": float(_clouds(target, N, seed, 1)[2][0]),
        "bandwidth h, in standard deviations of the cloud": float(h),
        "integrated square error of this cloud, per cent": 100 * float(error),
        f"error, mean of {CLOUDS} clouds, per cent": 100 * float(mean[at]),
        "standard error of that mean": 100 * float(sd[at] / np.sqrt(CLOUDS)),
        "the formula's, for independent draws, not shrunk": 100 * float(_theory(target, N, kernel)[at]),
        "best position over the clouds": FACTORS[best],
        "mean error there": 100 * float(mean[best]),
        "variance of the moved points over the exact one": float(ratio),
        f"variance ratio, mean of {CLOUDS} clouds": float(mean_ratio),
        "expected, if the cloud were exact": float(expected),
    }
    near = "here" if best == at else f"at {FACTORS[best]:g} ({100 * mean[best]:.2g} %)"
    sentence = (
        f"Posterior with {target}" if target != "skewed" else "Skewed posterior"
    ) + (
        f", N = {N}, {kernel.capitalize()} kernel with {factor:g} times the formula's bandwidth, h = {h:.3f}, "
        f"{'with' if shrink == 'yes' else 'without'} shrinkage: resampling left {len(np.unique(x))} different points. "
        f"The integrated square error is {100 * error:.2g} % of the square of the exact density, on average over "
        f"{CLOUDS} clouds {100 * mean[at]:.2g} %; it is least {near}. The moved points have {ratio:.2f} times the "
        f"exact variance, on average {mean_ratio:.2f}."
    )  # fmt: skip
    return Shown(sentence, numbers)


def _fine_enough(params, numbers):
    """Whether two peaks are smoothed with little error."""
    return params["target"] == "two peaks" and numbers[f"error, mean of {CLOUDS} clouds, per cent"] < 2


def _right_variance_wrong_shape(params, numbers):
    """Whether the moved points have the exact variance, and their density has another shape."""
    off = abs(numbers[f"variance ratio, mean of {CLOUDS} clouds"] - 1)
    return off < 0.03 and numbers[f"error, mean of {CLOUDS} clouds, per cent"] > 30


PUZZLES = (
    Puzzle(
        f"Keep the posterior with two peaks, and find a setting with which the mean error of the {CLOUDS} clouds is "
        "below 2 per cent.",
        _fine_enough,
        {"N": 1000, "factor": 0.4},
    ),
    Puzzle(
        "Get the variance right and the shape wrong: find a setting with which the moved points have on average the "
        f"exact variance, within 3 per cent, and the mean error of the {CLOUDS} clouds is above 30 per cent.",
        _right_variance_wrong_shape,
        {"shrink": "yes", "factor": 1.4},
    ),
)


EXPLORER = Explorer(
    title="How wide a kernel?",
    controls=CONTROLS,
    layouts={
        "wide": ((7.6, 5.2), [["density", "density"], ["error", "variance"]]),
        "narrow": ((3.7, 7.2), [["density"], ["error"], ["variance"]]),
    },
    build=build,
    update=update,
    also=(
        *({"target": "one peak", "factor": f} for f in (0.1, 0.5, 1.2, 1.4, 2.0)),
        *({"shrink": "yes", "factor": f} for f in (0.1, 0.3, 0.5, 1.4, 2.0)),
        *({"kernel": "epanechnikov", "factor": f} for f in (0.3, 0.5)),
        *({"factor": 0.4, "N": n} for n in (50, 500, 2000)),
    ),
    puzzles=PUZZLES,
)
