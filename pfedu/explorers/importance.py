"""Explorer of chapter 2: importance sampling of one variable, and what it reports beside what is true."""

from functools import lru_cache
from math import lgamma

import numpy as np

from pfedu.explorers.controls import Choice, Seed, Slider
from pfedu.explorers.explorer import Explorer, Puzzle, Shown
from pfedu.figures.density import particle_histogram
from pfedu.figures.style import COLORS

RUNS = 100  # samples from which the true error is taken; the first of them is the one shown
SIZES = (10, 15, 20, 30, 40, 50, 70, 100, 150, 200, 300, 400, 500, 700, 1000, 1500, 2000)
REACH, LEVEL = 8.0, 2.0
NODES = (np.arange(-6000, 6000) + 0.5) / 100  # of the exact integrals; none stands on the level
MIXTURES = {  # share, mean and variance of each Gaussian
    "one peak": ((1.0, 0.0, 1.0),),
    "two peaks": ((0.6, -2.0, 0.36), (0.4, 2.0, 0.36)),
}
NU_TARGET, NU_PROPOSAL = 5, 3  # degrees of freedom where a Student t is meant
QUESTIONS = {"mean of x": lambda x: x, "P(x > 2)": lambda x: (x > LEVEL).astype(float)}

CONTROLS = (
    Choice("target", "target p", (*MIXTURES, "heavy tails"), "one peak"),
    Choice("phi", "what is asked", tuple(QUESTIONS), "mean of x"),
    Choice("shape", "proposal q", ("Gaussian", "Student t"), "Gaussian"),
    Slider("m", "centre of the proposal", tuple(i / 2 for i in range(-8, 9)), 0.0, drawn=9),
    Slider("s", "width s of the proposal", (0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0), 2.0,
           drawn=14),
    Slider("N", "draws N", SIZES, 200, drawn=10),
    Seed("draws", "new draws"),
)  # fmt: skip


def log_student(x, nu):
    """Log density of the standard Student t with nu degrees of freedom: shape of x."""
    constant = lgamma((nu + 1) / 2) - lgamma(nu / 2) - 0.5 * np.log(nu * np.pi)
    return constant - (nu + 1) / 2 * np.log1p(np.square(x) / nu)


def log_normal(x, m, P):
    """Log density of N(m, P) for a scalar: shape of x."""
    return -0.5 * (np.square(x - m) / P + np.log(2 * np.pi * P))


def log_target(target, x):
    """Log density of a target, normalised: shape of x."""
    if target not in MIXTURES:
        return log_student(x, NU_TARGET)
    (share, m, P), *others = MIXTURES[target]
    log_p = np.log(share) + log_normal(x, m, P)
    for share, m, P in others:
        log_p = np.logaddexp(log_p, np.log(share) + log_normal(x, m, P))
    return log_p


def log_proposal(shape, m, s, x):
    """Log density of a proposal of centre m and width s: shape of x."""
    return log_normal(x, m, s * s) if shape == "Gaussian" else log_student((x - m) / s, NU_PROPOSAL) - np.log(s)


def finite(target, shape, s):
    """Whether the weights have a finite variance: the tails of p^2 / q decide."""
    if shape == "Student t":
        return True
    return target in MIXTURES and s * s > max(P for *_, P in MIXTURES[target]) / 2


@lru_cache(maxsize=4)
def _standard(draws):
    """Draws from N(0, 1), and what makes a Student t of them; (RUNS, N) each."""
    rng = np.random.default_rng(draws)
    z = rng.standard_normal((RUNS, SIZES[-1]))
    return z, np.sqrt(NU_PROPOSAL / rng.chisquare(NU_PROPOSAL, z.shape))


@lru_cache(maxsize=8)
def _samples(target, phi, shape, m, s, draws):
    """The first sample with its weights, and mean, standard error, N_eff and Z of each run at each size."""
    z, stretch = _standard(draws)
    x = m + s * (z if shape == "Gaussian" else z * stretch)
    W = np.exp(log_target(target, x) - log_proposal(shape, m, s, x))
    value, first = QUESTIONS[phi](x), (0, *SIZES[:-1])
    upto = lambda terms: np.add.reduceat(terms, first, axis=-1).cumsum(axis=-1)  # noqa: E731  (RUNS, sizes)
    total, squares = upto(W), upto(W * W)
    mean = upto(W * value) / total
    var = upto((W * value) ** 2) - 2 * mean * upto(W * W * value) + mean**2 * squares
    error = np.sqrt(np.maximum(var, 0.0)) / total
    return x[0], W[0], mean, error, total**2 / squares, total / np.array(SIZES)


@lru_cache(maxsize=64)
def _exact(target, phi, shape, m, s):
    """Mean and variance of phi under p; 1 + chi^2 and N times the variance of the estimate, None if infinite."""
    log_p, value, dx = log_target(target, NODES), QUESTIONS[phi](NODES), 0.01
    mean = round(float(np.sum(np.exp(log_p) * value) * dx), 12) + 0.0  # of a symmetric target 0, not -1e-17
    square = (value - mean) ** 2
    variance = np.sum(np.exp(log_p) * square) * dx
    if not finite(target, shape, s):
        return mean, variance, None, None
    ratio = np.exp(2 * log_p - log_proposal(shape, m, s, NODES)) * dx
    return mean, variance, ratio.sum(), ratio @ square


def build(axes):
    """Draw what stays; return the artists that move."""
    d, w, e = axes["densities"], axes["weights"], axes["error"]
    exact, own = dict(color=COLORS["exact"], lw=1.6), dict(color=COLORS["particles"], lw=1.5)
    q = dict(color=COLORS["second"], ls="--", lw=1.6)
    artists = {
        "bars": d.fill_between([0, 1], 0, 0, step="post", color=COLORS["light"], alpha=0.6, lw=0,
                               label="weighted draws"),
        "target": d.plot([], [], label="target p", **exact)[0],
        "proposal": d.plot([], [], label="proposal q", **q)[0],
        "mean": d.axvline(0, color=COLORS["exact"], ls=":", lw=1.4),
        "estimate": d.axvline(0, color=COLORS["particles"], ls="-.", lw=1.4),
        "level": d.axvline(LEVEL, color=COLORS["measurement"], lw=3, alpha=0.4),
        "ratio": w.plot([], [], color=COLORS["measurement"], lw=1.2, label="p / q")[0],
        "draws": w.plot([], [], "o", color=COLORS["particles"], ms=3, alpha=0.5, mew=0, label="draws")[0],
        "band": e.fill_between([10, 20], 1, 1, color=COLORS["accent"], alpha=0.35, lw=0),
        "true": e.plot([], [], "o-", color=COLORS["accent"], ms=3.5, lw=1.2, label="true, of 100 samples")[0],
        "own": e.plot([], [], "--", label="what they report", **own)[0],
        "formula": e.plot([], [], ":", color=COLORS["exact"], lw=2, label="formula for large N")[0],
        "N": e.axvline(100, color=COLORS["light"], lw=5, alpha=0.4),
    }  # fmt: skip
    d.set(xlim=(-REACH, REACH), ylim=(0, 1.1), ylabel="density", title="Densities")
    w.set(xlim=(-REACH, REACH), yscale="log", ylim=(1e-4, 1e4), xlabel="x", ylabel="weight W",
          title="Weights: the draws lie on p / q")  # fmt: skip
    w.axhline(1, color=COLORS["truth"], lw=0.6)
    sizes = np.array(SIZES)
    e.plot(sizes, 1 / np.sqrt(sizes), "-", color=COLORS["measurement"], lw=0.9, label="draws from p itself")
    e.set(xscale="log", yscale="log", xlim=(9, 2200), ylim=(0.006, 6.0), xlabel="draws N",
          ylabel="RMS error / sd under p", title="Error of the estimate")  # fmt: skip
    for ax in (d, w):
        ax.legend(loc="upper right", handlelength=1.8)
    wide = e.figure.get_figwidth() > 5
    above = dict(ncols=2, loc="lower center", bbox_to_anchor=(0.45, 1.12), columnspacing=1.0)
    e.legend(handlelength=1.8, **(dict(loc="upper right") if wide else above))
    return artists


def update(artists, axes, target, phi, shape, m, s, N, draws):
    """Sample, weigh, and give the artists their data."""
    sample = _samples(target, phi, shape, m, s, draws)
    exact = _exact(target, phi, shape, m, s)
    at = SIZES.index(N)
    _show_densities(artists, target, phi, shape, m, s, N, sample, exact, at)
    _show_errors(artists, sample, exact, N)
    return _say(target, phi, shape, m, s, N, sample, exact, at)


def _show_densities(artists, target, phi, shape, m, s, N, sample, exact, at):
    state = np.linspace(-REACH, REACH, 401)
    log_p, log_q = log_target(target, state), log_proposal(shape, m, s, state)
    x, W, edges = sample[0][:N], sample[1][:N], np.linspace(-REACH, REACH, 65)
    bars = np.repeat(particle_histogram(x, np.log(np.maximum(W / W.sum(), 1e-300)), edges), 2)
    artists["bars"].set_verts([np.r_[np.c_[np.repeat(edges, 2)[1:-1], bars], [[REACH, 0], [-REACH, 0]]]])
    artists["target"].set_data(state, np.exp(log_p))
    artists["proposal"].set_data(state, np.exp(log_q))
    artists["ratio"].set_data(state, np.exp(np.clip(log_p - log_q, -20, 20)))
    artists["draws"].set_data(x, W)
    artists["mean"].set_xdata([exact[0]] * 2)
    artists["estimate"].set_xdata([sample[2][0, at]] * 2)
    for name in ("mean", "estimate", "level"):
        artists[name].set_visible((name == "level") == (phi == "P(x > 2)"))


def _show_errors(artists, sample, exact, N):
    sizes, unit, (true, margin) = np.array(SIZES), np.sqrt(exact[1]), _true_error(sample, exact)
    artists["true"].set_data(sizes, true / unit)
    low, high = np.maximum(true - 2 * margin, 1e-9) / unit, (true + 2 * margin) / unit
    artists["band"].set_verts([np.c_[np.r_[sizes, sizes[::-1]], np.r_[low, high[::-1]]]])
    artists["own"].set_data(sizes, np.sqrt(np.mean(sample[3] ** 2, axis=0)) / unit)
    valid = sizes[sizes >= exact[2]] if exact[2] else sizes[:0]  # below 1 + chi^2 the formula says nothing
    artists["formula"].set_data(valid, np.sqrt((exact[3] or 0.0) / valid) / unit)
    artists["N"].set_xdata([N, N])


def _true_error(sample, exact):
    """Root mean square error over the runs at each size, and its standard error."""
    square = (sample[2] - exact[0]) ** 2
    true = np.sqrt(square.mean(axis=0))
    return true, square.std(axis=0, ddof=1) / np.sqrt(RUNS) / (2 * true)


def _say(target, phi, shape, m, s, N, sample, exact, at):
    mean, error, n_eff, z = (quantity[:, at] for quantity in sample[2:])
    true, own = _true_error(sample, exact)[0][at], np.sqrt(np.mean(error**2))
    inside = int(np.sum(np.abs(mean - exact[0]) <= 2 * error))
    weight = sample[1][:N].max() / sample[1][:N].sum()
    numbers = {
        "estimate": mean[0],
        "its standard error, as the sample sees it": error[0],
        "exact": exact[0],
        "estimate of Z (exact: 1)": z[0],
        "N_eff": n_eff[0],
        "largest weight": weight,
        "root mean square error over 100 samples": true,
        "what the samples report": own,
        "intervals of ±2 standard errors that hold the exact value, of 100": inside,
        "error of as many draws from p itself": np.sqrt(exact[1] / N),
    }
    if exact[2] is None:
        law = "The weights have no finite variance, so there is no formula for the error"
    elif exact[2] > N:
        law = f"N is less than 1 + χ² = {exact[2]:.2g}, so the formula for large N says nothing yet"
    else:
        numbers["N / (1 + χ²), where N_eff tends to"] = N / exact[2]
        numbers["error by the formula for large N"] = np.sqrt(exact[3] / N)
        law = f"For large N one expects N_eff = {N / exact[2]:.0f} and an error of {np.sqrt(exact[3] / N):.2g}"
    sentence = (
        f"Target with {target}, {shape} proposal of centre {m:g} and width {s:g}, N = {N}: {phi} is "
        f"{mean[0]:.3f} ± {error[0]:.3f} by this sample, {exact[0]:.3f} exactly. "
        f"N_eff is {n_eff[0]:.0f}, and the largest weight {100 * weight:.1f} %. {law}. "
        f"Over 100 samples the error is {true:.2g} (root mean square); they report {own:.2g}, and {inside} of their "
        "intervals of ±2 standard errors hold the exact value."
    )
    return Shown(sentence, {name: float(value) for name, value in numbers.items()})


def _worse_with_more(params, numbers):
    """Whether the intervals of 2000 draws hold the exact value much less often than those of 20."""
    target, phi, shape, m, s = (params[name] for name in ("target", "phi", "shape", "m", "s"))
    off = np.abs(_samples(target, phi, shape, m, s, params["draws"])[2] - _exact(target, phi, shape, m, s)[0])
    held = np.sum(off <= 2 * _samples(target, phi, shape, m, s, params["draws"])[3], axis=0)
    return held[SIZES.index(2000)] <= held[SIZES.index(20)] - 20


def _two_thirds_will_do(params, numbers):
    """Whether the proposal needs less than two thirds of the draws that heavy tails themselves need for their mean."""
    if (params["target"], params["phi"]) != ("heavy tails", "mean of x"):
        return False
    _, variance, _, times = _exact("heavy tails", "mean of x", params["shape"], params["m"], params["s"])
    return times is not None and times < 2 / 3 * variance


PUZZLES = (
    Puzzle(
        "Find a proposal with which more draws make matters worse: of the 100 intervals, at least 20 fewer hold the "
        "exact value with 2000 draws than with 20.",
        _worse_with_more,
        {"phi": "P(x > 2)", "m": 1.5, "s": 0.4},
    ),
    Puzzle(
        "Take the target with heavy tails, ask for the mean of x, and find a proposal that by the formula for large N "
        "needs less than two thirds of the draws that p itself would need for the same error.",
        _two_thirds_will_do,
        {"target": "heavy tails", "shape": "Student t"},
    ),
)


EXPLORER = Explorer(
    title="Importance sampling beside the exact answer",
    controls=CONTROLS,
    layouts={
        "wide": ((7.6, 5.0), [["densities", "error"], ["weights", "error"]]),
        "narrow": ((3.7, 6.6), [["densities"], ["weights"], ["error"]]),
    },
    build=build,
    update=update,
    also=(
        *({"shape": "Student t", "s": s} for s in (0.4, 0.5, 0.6, 0.7, 0.8, 1.0)),
        *({"target": "two peaks", "m": -2.0, "s": s} for s in CONTROLS[4].values[:11]),
        *({"phi": "P(x > 2)", "m": m, "s": s} for s in (1.0, 2.0) for m in (0.0, 1.0, 2.0, 3.0, 4.0)),
    ),
    puzzles=PUZZLES,
)
