"""Explorer of chapter 3: the SIR filter beside the exact answer, for two models."""

from functools import lru_cache

import numpy as np

import pfedu
from pfedu.explorers.controls import Choice, Seed, Slider, geometric
from pfedu.explorers.explorer import Explorer, Puzzle, Shown
from pfedu.figures.density import particle_histogram
from pfedu.figures.style import COLORS
from pfedu.resampling import SCHEMES, always, interval, never, ratio, systematic

T = 50
DOTS = 60  # dots a time step that stand for the particles
# Nodes for the exact posterior of the growth model: dense about zero, where one step moves neighbours 25 times apart.
_U, _DU = np.linspace(-np.arcsinh(50.0 / 8.0), np.arcsinh(50.0 / 8.0), 801, retstep=True)
GRID, DX = 8.0 * np.sinh(_U), 8.0 * np.cosh(_U) * _DU  # the integral of p is p @ DX
MODELS = {"growth model": pfedu.models.growth, "random walk": pfedu.models.random_walk}
POLICIES = ("ratio", "always", "every 5th step", "never")

CONTROLS = (
    Choice("model", "model", tuple(MODELS), "growth model"),
    Slider("N", "particles N", geometric(10, 5000, 28), 500),
    Slider("q", "process noise variance q", geometric(1.0, 40.0, 17), 10.0),
    Slider("r", "measurement noise variance r", geometric(0.5, 20.0, 17), 1.0),
    Choice("scheme", "resampling scheme", tuple(sorted(SCHEMES)), "systematic"),
    Choice("policy", "resampling policy", POLICIES, "ratio"),
    Slider("threshold", "threshold of the ratio policy", tuple(i / 10 for i in range(11)), 0.5),
    Slider("k", "time step k", range(T + 1), 22, drawn=18, plays=True),
    Seed("data", "new data"),
    Seed("particles", "new particles"),
)


@lru_cache(maxsize=16)
def _record(model, q, r, data):
    """Truth, record without its first row, and the exact posterior."""
    system = MODELS[model](q=q, r=r)
    x, y = system.simulate(T, np.random.default_rng(data))
    y[0] = np.nan  # the lecture's convention: the first measurement is not used
    return system, x, y, pfedu.kalman_filter(system, y) if hasattr(system, "F") else _exact_growth(system, y)


def _exact_growth(system, y):
    r"""What ``pfedu.grid_filter`` gives on GRID, many times faster.

    A prediction is the sum of Gaussians N(x; f(k, x_j), q) with the masses of the nodes. The sum of their Fourier
    transforms is a short one, and the cosine of step k only turns its phases, so two small tables serve all steps.
    """
    q, zero = system.Q[0, 0], np.zeros(1)
    omega = np.arange(np.ceil(6.5 * 140.0 / (2 * np.pi * np.sqrt(q)))) * (2 * np.pi / 140.0)
    weight = np.exp(-0.5 * q * omega**2) * np.where(omega == 0, 0.5, 1.0) / 70.0
    shift = [system.f(k, zero)[0] for k in range(len(y))]  # f(k, x) = f(0, x) - f(0, 0) + shift[k]
    leave = np.exp(-1j * omega[:, None] * (system.f(0, GRID[:, None])[:, 0] - shift[0]))  # (frequencies, nodes)
    arrive = np.exp(1j * GRID[:, None] * omega) * weight  # (nodes, frequencies)
    p, densities, increments = np.exp(system.log_initial(GRID[:, None])), [], [0.0]
    for k in range(len(y)):
        if k > 0:
            p = np.maximum((arrive @ (np.exp(-1j * omega * shift[k]) * (leave @ (p * DX)))).real, 0.0)
            p = p * np.exp(system.log_likelihood(k, y[k], GRID[:, None]))
            increments.append(np.log(p @ DX))
            p = p / (p @ DX)
        densities.append(p)
    density = np.array(densities)
    mean = density @ (DX * GRID)
    var = np.sum(density * DX * (GRID - mean[:, None]) ** 2, axis=-1)
    return pfedu.Track(mean[:, None], var[:, None, None], np.array(increments), grid=GRID, density=density)


@lru_cache(maxsize=4)
def _filter(model, q, r, data, N, scheme, policy, threshold, particles):
    system, _, y, _ = _record(model, q, r, data)
    rule = {"ratio": ratio(threshold), "always": always, "every 5th step": interval(5), "never": never}[policy]
    rng = np.random.default_rng([particles, 2])
    return pfedu.bootstrap_filter(system, y, N, rng=rng, resampling=scheme, policy=rule, keep=True)


def build(axes):
    """Draw what stays; return the artists that move."""
    t, d, e = axes["track"], axes["posterior"], axes["n_eff"]
    exact, mine = dict(color=COLORS["exact"], ls="--", lw=1.5), dict(color=COLORS["particles"], lw=1.5)
    artists = {
        "step": t.axvline(0, color=COLORS["accent"], lw=5, alpha=0.4),
        "band": t.fill_between([0, 1], 0, 1, color=COLORS["light"], alpha=0.3, lw=0),
        "dots": t.plot([], [], ".", color=COLORS["particles"], ms=3.2, alpha=0.4, mew=0, label="particles")[0],
        "y": t.plot([], [], "x", color=COLORS["measurement"], ms=4, label="measurement")[0],
        "truth": t.plot([], [], color=COLORS["truth"], lw=1.2, label="truth")[0],
        "exact": t.plot([], [], label="exact mean", **exact)[0],
        "mean": t.plot([], [], label="SIR mean, ±2 sd", **mine)[0],
        "bars": d.fill_between([0, 1], 0, 0, step="post", color=COLORS["light"], alpha=0.6, lw=0, label="particles"),
        "density": d.plot([], [], label="exact", **exact)[0],
        "truth_k": d.axvline(0, color=COLORS["truth"], lw=1.2, label="truth"),
        "n_eff": e.plot([], [], color=COLORS["second"], lw=1.4, marker="o", ms=2.5)[0],
        "threshold": e.axhline(0.5, color=COLORS["measurement"], ls=":", lw=1.2),
        "resampled": e.plot([], [], "v", color=COLORS["third"], ms=4)[0],
        "step_e": e.axvline(0, color=COLORS["accent"], lw=5, alpha=0.4),
    }
    t.set(xlim=(-0.7, T + 0.7), xlabel="time step k", ylabel="state", title="Truth, particles and estimates")
    wide = t.figure.get_figwidth() > 5
    t.legend(ncols=5 if wide else 2, loc="lower center", bbox_to_anchor=(0.5, 1.12), markerscale=2,
             handlelength=1.6, columnspacing=1.0)  # fmt: skip
    d.set(ylim=(0, 1.6), yticks=[0, 0.5, 1, 1.5], ylabel="density / exact peak", title="Posterior at step k")
    d.legend(loc="upper right", handlelength=1.4)
    e.set(xlim=(-0.7, T + 0.7), ylim=(0, 1.12), xlabel="time step k", ylabel="$N_{eff}$ / N",
          title="Effective share of particles (▼ resampled)")  # fmt: skip
    return artists


def update(artists, axes, model, N, q, r, scheme, policy, threshold, k, data, particles):
    """Run the filter and give the artists their data."""
    policy = "never" if policy == "ratio" and not threshold else policy
    threshold = threshold if policy == "ratio" else 0.0
    _, x, y, exact = _record(model, q, r, data)
    track = _filter(model, q, r, data, N, scheme, policy, threshold, particles)
    _show_track(artists, axes["track"], model, x, y, exact, track, k)
    _show_posterior(artists, axes["posterior"], model, x, exact, track, k)
    _show_n_eff(artists, track, N, policy, threshold, k)
    return _say(x, exact, track, model, N, policy, threshold, k)


def _show_track(artists, ax, model, x, y, exact, track, k):
    times = np.arange(T + 1)
    values = np.concatenate([x.ravel(), _as_states(model, y).ravel()])
    limits = 10 * np.floor(np.nanmin(values) / 10 - 0.1), 10 * np.ceil(np.nanmax(values) / 10 + 0.1)
    if ax.get_ylim() != limits:
        ax.set_ylim(*limits)
    picks = systematic(np.exp(track.log_weights), np.random.default_rng(0), size=DOTS)  # dots as dense as the weights
    cloud = np.take_along_axis(track.particles[..., 0], picks, axis=-1)
    artists["dots"].set_data(np.repeat(times, DOTS), cloud.ravel())
    states = _as_states(model, y)
    artists["y"].set_data(np.tile(times, len(states)), states.ravel())
    artists["truth"].set_data(times, x[:, 0])
    artists["exact"].set_data(times, exact.mean[:, 0])
    artists["mean"].set_data(times, track.mean[:, 0])
    low, high = (track.mean + s * track.sd for s in (-2, 2))
    artists["band"].set_verts([np.c_[np.r_[times, times[::-1]], np.r_[low[:, 0], high[::-1, 0]]]])
    artists["step"].set_xdata([k, k])


def _as_states(model, y):
    """The states a measurement points to: y itself, or both square roots of 20 y; (rows, T+1)."""
    if model == "random walk":
        return y.T
    root = np.sqrt(20 * np.clip(y[:, 0], 0, None))
    return np.stack([root, -root])


def _show_posterior(artists, ax, model, x, exact, track, k):
    if model == "random walk":  # one narrow peak: look at it from its own mean
        origin, label = exact.mean[k, 0], "state minus exact mean"
        reach = 8.0 * np.ceil(exact.sd[1:].max() / 2.0)
        nodes = np.linspace(-reach, reach, 201)
        density = np.exp(-0.5 * (nodes / exact.sd[k, 0]) ** 2) / (exact.sd[k, 0] * np.sqrt(2 * np.pi))
    else:
        origin, reach, label = 0.0, 40.0, "state"
        nodes, density = exact.grid, exact.density[k]
    if (ax.get_xlabel(), ax.get_xlim()) != (label, (-reach, reach)):
        ax.set(xlim=(-reach, reach), xlabel=label)
    edges = np.linspace(-reach, reach, 201 if model == "growth model" else 65)
    bars = particle_histogram(track.particles[k, :, 0] - origin, track.log_weights[k], edges) / density.max()
    heights = np.repeat(bars, 2)
    artists["bars"].set_verts([np.r_[np.c_[np.repeat(edges, 2)[1:-1], heights], [[reach, 0], [-reach, 0]]]])
    artists["density"].set_data(nodes, density / density.max())
    artists["truth_k"].set_xdata([x[k, 0] - origin] * 2)


def _show_n_eff(artists, track, N, policy, threshold, k):
    times = np.arange(T + 1)
    artists["n_eff"].set_data(times, track.n_eff / N)
    artists["resampled"].set_data(times[track.resampled], np.full(track.resampled.sum(), 1.05))
    artists["threshold"].set_ydata([threshold] * 2)
    artists["threshold"].set_visible(policy == "ratio")
    artists["step_e"].set_xdata([k, k])


def _say(x, exact, track, model, N, policy, threshold, k):
    times = int(track.resampled.sum())
    numbers = {
        "RMSE of the SIR mean against the truth": _rms(track.mean - x),
        "RMSE of the exact mean against the truth": _rms(exact.mean - x),
        "RMS distance of the SIR mean to the exact mean": _rms(track.mean - exact.mean),
        "the same, in posterior standard deviations": _rms((track.mean - exact.mean) / exact.sd),
        "times resampled": times,
        "log-likelihood, SIR": float(track.log_likelihood),
        "log-likelihood, exact": float(exact.log_likelihood),
        "SIR mean at step k": float(track.mean[k, 0]),
        "exact mean at step k": float(exact.mean[k, 0]),
        "SIR standard deviation at step k": float(track.sd[k, 0]),
        "exact standard deviation at step k": float(exact.sd[k, 0]),
        "N_eff at step k": float(track.n_eff[k]),
    }
    rmse, best, gap, share = list(numbers.values())[:4]
    when = f"when N_eff fell below {threshold:g} N" if policy == "ratio" else f"policy: {policy}"
    luck = " (luck: on average nothing beats the exact mean)" if rmse < best else ""
    sentence = (
        f"{model.capitalize()}, N = {N}: resampled {times} times in {T} steps ({when}). "
        f"The SIR mean misses the truth by {rmse:.2f} (RMSE), the exact mean by {best:.2f}{luck}; "
        f"the two means are {gap:.2f} apart ({share:.2f} posterior sd). "
        f"At step {k}, N_eff is {track.n_eff[k]:.0f} of {N}."
    )
    return Shown(sentence, numbers)


def _rms(error):
    """Over steps 1 to T: no measurement is used at step 0."""
    return float(np.sqrt(np.mean(error[1:] ** 2)))


def _always_resampled(params, numbers):
    """Whether a low threshold makes the random walk's filter resample at every step."""
    walks = params["model"] == "random walk" and params["policy"] == "ratio" and params["threshold"] <= 0.3
    return walks and numbers["times resampled"] == T


def _few_of_many(params, numbers):
    """Whether one measurement leaves fewer than four of a thousand particles or more, evenly weighted before it."""
    k, names = params["k"], ("model", "q", "r", "data", "N", "scheme", "policy", "threshold", "particles")
    if k == 0 or params["N"] < 1000 or numbers["N_eff at step k"] >= 4:
        return False
    threshold = params["threshold"] if params["policy"] == "ratio" else 0.0
    track = _filter(**{name: params[name] for name in names} | {"threshold": threshold})
    return k == 1 or track.resampled[k - 1]


PUZZLES = (
    Puzzle(
        "Take the random walk, keep the policy ratio with a threshold of 0.3 or less, and make the filter resample at "
        "every one of the 50 steps.",
        _always_resampled,
        {"model": "random walk", "threshold": 0.3, "q": 40.0},
    ),
    Puzzle(
        "Take 1000 particles or more, and find a step k at which a single measurement leaves N_eff below 4, although "
        "all weights were equal before it (the filter resampled at step k−1).",
        _few_of_many,
        {"model": "random walk", "N": 1000, "k": 38},
    ),
)


EXPLORER = Explorer(
    title="The SIR filter beside the exact answer",
    controls=CONTROLS,
    layouts={
        "wide": ((7.6, 5.0), [["track", "track"], ["posterior", "n_eff"]]),
        "narrow": ((3.7, 5.6), [["track"], ["posterior"], ["n_eff"]]),
    },
    build=build,
    update=update,
    also=(
        *({"model": "random walk", "r": r} for r in CONTROLS[3].frames()),
        {"model": "random walk", "policy": "never"},
        *({"model": "random walk", "r": 0.5, "N": 10, "particles": seed} for seed in (1, 2, 3)),
        *({"N": n, "particles": seed} for n in (10, 5000) for seed in CONTROLS[9].frames()),
    ),
    puzzles=PUZZLES,
)
