"""Explorer of chapter 6: the optimal importance density beside the transition that the bootstrap filter draws from."""

from functools import lru_cache

import numpy as np

import pfedu
from pfedu.explorers.controls import Choice, Seed, Slider, geometric
from pfedu.explorers.explorer import Explorer, Puzzle, Shown
from pfedu.figures.density import particle_histogram
from pfedu.figures.style import COLORS
from pfedu.resampling import always, never, ratio

T = 50
POWERS = {"x²/(1+x²)": 2, "x²/(1+x³)": 3}
POLICIES = {"ratio 0.5": ratio(0.5), "always": always, "never": never}
FILTERS = {"bootstrap": pfedu.bootstrap_filter, "optimal": pfedu.optimal_filter}
EDGES = np.linspace(-4.0, 4.0, 41)  # of the histograms, in posterior standard deviations
DRAWS = np.random.default_rng(6).standard_normal(40)  # one set of noises for either proposal
ERRORS = (1e-3, 1e2)  # ends of the axis of errors

CONTROLS = (
    Choice("model", "motion", tuple(POWERS), "x²/(1+x²)"),
    Slider("N", "particles N", geometric(10, 2000, 24), 500, drawn=6),
    Slider("q", "process noise variance q", geometric(0.1, 10.0, 13), 1.0, drawn=7),
    Slider("r", "measurement noise variance r", geometric(0.01, 10.0, 19), 0.01, drawn=10),
    Choice("policy", "resampling policy", tuple(POLICIES), "ratio 0.5"),
    Slider("k", "time step k", range(1, T + 1), 8, plays=True),
    Seed("data", "new data", drawn=4),
    Seed("particles", "new particles", drawn=4),
    Seed("which", "another particle of step k−1", drawn=5),
)


@lru_cache(maxsize=16)
def _record(model, q, r, data):
    """Model, record without its first row, the exact posterior, and the weights of the integral over its nodes."""
    system = pfedu.models.ratio(q=q, r=r, power=POWERS[model])
    _, y = system.simulate(T, np.random.default_rng(data))
    y[0] = np.nan  # the lecture's convention: the first measurement is not used
    x, dx = _nodes(POWERS[model], q, r, y[1:, 0])
    return system, y, _exact(system, y, x, dx), dx


def _nodes(power, q, r, y):
    """Nodes and the weights of their integral, for this record alone.

    Evenly spaced in u = d / h, d = x + 1, where no posterior is narrower than sqrt(q r / (q + r)). With the pole, in
    u = d / h - 1 / (3 step d): the motion is about 1 / (3 d) there, and so moves neighbours at most about ``step``
    apart. The equation for d is quadratic, with one root on either side. The innermost nodes go farther than anything
    was measured, and stand for the gap up to the pole as well.
    """
    h, step = min(0.8 * np.sqrt(q * r / (q + r)), 0.3), 0.8 * np.sqrt(q)
    reach = max(20.0, np.abs(y).max() + 8 * np.sqrt(q + r))
    if power == 2:
        d = h * np.arange(-np.ceil(reach / h), np.ceil(reach / h))
        dx = np.full(d.shape, h)
    else:
        u = np.arange(-np.ceil(reach / step), np.ceil((reach + 1) / h))
        d = 0.5 * h * (u + np.sqrt(u * u + 4 / (3 * h * step)))
        dx = 1 / (1 / h + 1 / (3 * step * d * d))
        dx[0] += d[0] - dx[0] / 2
        d, dx = np.concatenate([-d[::-1], d]), np.concatenate([dx[::-1], dx])
    x = d - 1.0
    near = (np.abs(x) < 20) | (np.abs(x[:, None] - y).min(axis=-1) < 7.5 * np.sqrt(r))  # elsewhere: no probability
    return x[near], dx[near]


def _exact(system, y, x, dx):
    """What ``pfedu.grid_filter`` gives, many times faster: the step is the same at every time, and is computed once."""
    move, nodes = _moves(system, x, x, dx), x[:, None]
    densities, increments = [np.exp(system.log_initial(nodes))], [0.0]
    for k in range(1, len(y)):
        p = (move @ densities[-1]) * np.exp(system.log_likelihood(k, y[k], nodes))
        increments.append(np.log(p @ dx))
        densities.append(p / (p @ dx))
    density = np.array(densities)
    mean = density @ (dx * x)
    var = np.sum(density * dx * (x - mean[:, None]) ** 2, axis=-1)
    return pfedu.Track(mean[:, None], var[:, None, None], np.array(increments), grid=x, density=density)


def _moves(system, new, x, dx):
    """Matrix (new, old) that takes a density on the nodes x to the prediction at other states."""
    q = system.Q[0, 0]
    return np.exp(-0.5 * (new[:, None] - system.f(1, x[:, None])[:, 0]) ** 2 / q) * (dx / np.sqrt(2 * np.pi * q))


@lru_cache(maxsize=4)
def _filters(model, q, r, data, N, policy, particles):
    """Both filters, on the same random numbers."""
    system, y, _, _ = _record(model, q, r, data)
    how = dict(policy=POLICIES[policy], keep=True)
    return {name: run(system, y, N, rng=np.random.default_rng([particles, 6]), **how) for name, run in FILTERS.items()}


def build(axes):
    """Draw what stays; return the artists that move."""
    look = {
        "bootstrap": dict(color=COLORS["second"], ls="-.", lw=1.5),
        "optimal": dict(color=COLORS["particles"], lw=1.6),
    }
    dash = dict(color=COLORS["exact"], ls="--", lw=1.5)
    o, p, e, d = (axes[name] for name in ("one", "posterior", "n_eff", "error"))
    artists = {
        "likelihood": o.plot([], [], color=COLORS["measurement"], ls=":", lw=2.0, label="likelihood of $y_k$")[0],
        "transition": o.plot([], [], label="transition", **look["bootstrap"])[0],
        "density": o.plot([], [], label="optimal", **look["optimal"])[0],
        "blind": o.plot([], [], "|", color=COLORS["second"], ms=6)[0],
        "aimed": o.plot([], [], "|", color=COLORS["particles"], ms=6)[0],
        "bars": p.fill_between([0, 1], 0, 0, step="post", color=COLORS["second"], alpha=0.35, lw=0, label="bootstrap"),
        "steps": p.plot([], [], label="optimal", **look["optimal"])[0],
        "exact": p.plot([], [], label="exact", **dash)[0],
    }
    for name in FILTERS:
        marker = dict(marker="o" if name == "optimal" else "s", ms=2.5)
        artists[f"n_eff {name}"] = e.plot([], [], label=name, **look[name], **marker)[0]
        artists[f"error {name}"] = d.plot([], [], label=name, **look[name], **marker)[0]
        artists[f"rms {name}"] = d.axhline(1.0, color=look[name]["color"], ls=look[name].get("ls", "-"), lw=0.9)
    for ax in (e, d):
        artists[f"step {ax.get_label()}"] = ax.axvline(0, color=COLORS["accent"], lw=5, alpha=0.4)
        ax.set(xlim=(-0.7, T + 0.7), xlabel="time step k")
    _dress(o, p, e, d)
    return artists


def _dress(o, p, e, d):
    """Titles, limits and legends: what never changes."""
    o.set(ylim=(-0.27, 1.45), yticks=[0, 0.5, 1], title="One particle's step to time k")
    o.set(xlabel="state minus $f(x_{k-1}^{(i)})$", ylabel="density / peak of optimal")
    p.set(xlim=(-4, 4), ylim=(0, 2.3), yticks=[0, 0.5, 1, 1.5], title="Posterior at step k")
    p.set(xlabel="(state − exact mean) / exact sd", ylabel="density / exact peak")
    e.set(ylim=(0, 1.3), yticks=[0, 0.5, 1], ylabel="$N_{eff}$ / N", title="Effective share of particles")
    d.set(ylim=ERRORS, yscale="log", ylabel="|error| / exact sd", title="Distance to the exact mean (flat: RMS)")
    for ax in (o, p, e, d):
        ax.legend(loc="upper left", ncols=3, handlelength=1.8, columnspacing=0.9, borderaxespad=0.1)


def update(artists, axes, model, N, q, r, policy, k, data, particles, which):
    """Run both filters and give the artists their data."""
    system, y, exact, dx = _record(model, q, r, data)
    tracks = _filters(model, q, r, data, N, policy, particles)
    one = _particle(system, tracks["optimal"], y[k, 0], k, which)
    _show_particle(artists, axes["one"], q, r, y[k, 0], one)
    _show_posterior(artists, system, y[k], exact, dx, tracks, k)
    errors = {name: np.abs(track.mean - exact.mean)[:, 0] / exact.sd[:, 0] for name, track in tracks.items()}
    for name, track in tracks.items():
        artists[f"n_eff {name}"].set_data(np.arange(T + 1), track.n_eff / N)
        artists[f"error {name}"].set_data(np.arange(1, T + 1), np.clip(errors[name][1:], *ERRORS))
        artists[f"rms {name}"].set_ydata([np.clip(_rms(errors[name]), *ERRORS)] * 2)
    for name in ("n_eff", "error"):
        artists[f"step {name}"].set_xdata([k, k])
    return _say(model, N, q, r, policy, k, y, exact, tracks, errors, one)


def _particle(system, track, y, k, which):
    """A particle of step k-1, as likely as its weight, and what the measurement makes of its step."""
    cumulative = np.cumsum(np.exp(track.log_weights[k - 1]))
    i = min(np.searchsorted(cumulative, (which * 0.6180339887) % 1.0 * cumulative[-1]), cumulative.size - 1)
    f = system.f(k, track.particles[k - 1])  # (N, 1)
    q, r = system.Q[0, 0], system.R[0, 0]
    g = np.exp(-0.5 * (y - f[:, 0]) ** 2 / (q + r) - track.log_likelihood_increments[k]) / np.sqrt(2 * np.pi * (q + r))
    return {"x": float(track.particles[k - 1, i, 0]), "f": float(f[i, 0]), "factor": float(g[i]),
            "mean": float(f[i, 0] + q / (q + r) * (y - f[i, 0])), "sd": float(np.sqrt(q * r / (q + r)))}  # fmt: skip


def _show_particle(artists, ax, q, r, y, one):
    reach = 2.0 ** np.ceil(np.log2(max(3.5 * np.sqrt(q + r), 1.2 * abs(y - one["f"]))))  # seldom changes
    if ax.get_xlim() != (-reach, reach):
        ax.set_xlim(-reach, reach)
    a, sd = one["mean"] - one["f"], one["sd"]
    ways = {"likelihood": (y - one["f"], np.sqrt(r)), "transition": (0.0, np.sqrt(q)), "density": (a, sd)}
    z = np.linspace(-4.0, 4.0, 121)
    for name, (center, width) in ways.items():
        artists[name].set_data(center + width * z, np.exp(-0.5 * z * z) * sd / width)
    artists["blind"].set_data(np.sqrt(q) * DRAWS, np.full(DRAWS.size, -0.1))
    artists["aimed"].set_data(a + sd * DRAWS, np.full(DRAWS.size, -0.19))


def _show_posterior(artists, system, y, exact, dx, tracks, k):
    mean, sd = exact.mean[k, 0], exact.sd[k, 0]
    z = np.linspace(-4.0, 4.0, 121)
    prediction = _moves(system, mean + sd * z, exact.grid, dx) @ exact.density[k - 1]
    density = prediction * np.exp(system.log_likelihood(k, y, (mean + sd * z)[:, None]))  # smooth between the nodes
    artists["exact"].set_data(z, density / density.max())
    peak = density.max() / np.exp(exact.log_likelihood_increments[k])
    edges, heights = np.repeat(EDGES, 2)[1:-1], {}
    for name, track in tracks.items():
        bars = particle_histogram((track.particles[k, :, 0] - mean) / sd, track.log_weights[k], EDGES)
        heights[name] = np.repeat(bars, 2) / (sd * peak)
    artists["bars"].set_verts([np.r_[np.c_[edges, heights["bootstrap"]], [[EDGES[-1], 0], [EDGES[0], 0]]]])
    artists["steps"].set_data(edges, heights["optimal"])


def _say(model, N, q, r, policy, k, y, exact, tracks, errors, one):
    n_eff = {name: float(track.n_eff[1:].mean()) for name, track in tracks.items()}
    numbers = {}
    for name, track in tracks.items():
        numbers |= {
            f"mean N_eff, {name}": n_eff[name],
            f"RMS distance to the exact mean in posterior sd, {name}": _rms(errors[name]),
            f"N_eff at step k, {name}": float(track.n_eff[k]),
            f"times resampled, {name}": int(track.resampled.sum()),
            f"log-likelihood, {name}": float(track.log_likelihood),
        }
    numbers |= {
        "log-likelihood, exact": float(exact.log_likelihood),
        "measurement at step k": float(y[k, 0]),
        "the particle at step k−1": one["x"],
        "f of the particle": one["f"],
        "mean of its optimal density": one["mean"],
        "sd of its optimal density": one["sd"],
        "factor of its weight, average 1": one["factor"],
    }
    blind, best = (_rms(errors[name]) for name in FILTERS)
    sentence = (
        f"{model} with q = {q:g}, r = {r:g} and {N} particles (resampling: {policy}): N_eff averages "
        f"{n_eff['bootstrap']:.0f} in the bootstrap filter and {n_eff['optimal']:.0f} with the optimal density; their "
        f"means are {blind:.3f} and {best:.3f} posterior sd from the exact mean. The particle shown would move to "
        f"{one['f']:.2f}, the measurement says {y[k, 0]:.2f}, the optimal density is N({one['mean']:.2f}, "
        f"{one['sd'] ** 2:.2g}); the factor of its weight is {one['factor']:.2f} of the average."
    )
    return Shown(sentence, numbers)


def _rms(error):
    """Over steps 1 to T: no measurement is used at step 0."""
    return float(np.sqrt(np.mean(error[1:] ** 2)))


def _never_and_well(params, numbers):
    """Whether the optimal filter holds nearly all of its particles to the end without ever resampling."""
    last = params["policy"] == "never" and params["k"] == T
    return last and numbers["N_eff at step k, optimal"] > 0.95 * params["N"]


def _best_proposal_fails(params, numbers):
    """Whether one step from equal weights leaves the optimal filter less than 5 % of its particles."""
    if numbers["N_eff at step k, optimal"] >= 0.05 * params["N"]:
        return False
    track = _filters(*(params[name] for name in ("model", "q", "r", "data", "N", "policy", "particles")))["optimal"]
    return params["k"] == 1 or track.resampled[params["k"] - 1]


PUZZLES = (
    Puzzle(
        "Never resample, and have the optimal filter keep an N_eff of more than 95 % of N up to the last step, k = 50.",
        _never_and_well,
        {"policy": "never", "q": 10.0, "k": 50},
    ),
    Puzzle(
        "Find a step k at which even the optimal filter is left with an N_eff of less than 5 % of N, although all "
        "its weights were equal before (it resampled at step k−1).",
        _best_proposal_fails,
        {"model": "x²/(1+x³)", "policy": "always", "k": 13},
    ),
)


_LECTURE = {"model": "x²/(1+x³)", "q": 0.1, "r": 1.0}
EXPLORER = Explorer(
    title="The optimal importance density beside the bootstrap filter",
    controls=CONTROLS,
    layouts={
        "wide": ((7.6, 5.2), [["one", "posterior"], ["n_eff", "error"]]),
        "narrow": ((3.7, 8.4), [["one"], ["posterior"], ["n_eff"], ["error"]]),
    },
    build=build,
    update=update,
    also=(
        {"model": "x²/(1+x³)", "q": 0.1},
        _LECTURE,
        *(_LECTURE | {"policy": policy} for policy in POLICIES),
        *(_LECTURE | {"data": seed} for seed in CONTROLS[6].frames()),
        *(_LECTURE | {"policy": "never", "data": seed} for seed in CONTROLS[6].frames()),
    ),
    puzzles=PUZZLES,
)
