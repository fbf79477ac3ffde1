"""Explorer of chapter 10: what each further dimension costs, in closed form and by simulation."""

from functools import lru_cache

import numpy as np

from pfedu import dimension
from pfedu.explorers.controls import Choice, Seed, Slider, geometric
from pfedu.explorers.explorer import Explorer, Puzzle, Shown
from pfedu.figures.style import COLORS

TOP = 20  # largest weights that are shown
ERROR = 0.05  # squared error that is asked for, in posterior variances
DIMS = (1, 2, 4, 6, 10, 15, 20, 27, 35, 50)  # where the curves are simulated
EVERY = np.arange(1, 51)
PROPOSALS = {"bootstrap": dimension.bootstrap, "optimal": dimension.optimal}
INDEPENDENT = dimension.Proposal(0.0)
COUNTING = ("of each coordinate", "of all together")
STATE = np.linspace(-3.0, 4.0, 421)  # in standard deviations of the innovation

CONTROLS = (
    Choice("proposal", "proposal", tuple(PROPOSALS), "bootstrap"),
    Slider("n", "dimension n", (*range(1, 7), 8, 10, 12, 15, 20, 27, 35, 42, 50), 10, drawn=15),
    Slider("N", "particles N", geometric(10, 10000, 19), 1000, drawn=7),
    Slider("ratio", "process over measurement noise q/r", geometric(0.01, 100.0, 17), 1.0, drawn=9),
    Slider("z", "surprise z of every coordinate", (0.0, 0.5, 1.0, 1.5, 2.0, 3.0), 1.0),
    Choice("counting", "error asked for", COUNTING, COUNTING[0]),
    Seed("particles", "new particles"),
)


@lru_cache(maxsize=256)
def _simulated(K, fresh, n, N, z, seed):
    """Means and standard errors over some runs, (3, 2): N_eff, largest weight, error; and one run's top weights."""
    n_runs = int(np.clip(20_000 // N, 8, 200))
    proposal, rng = dimension.Proposal(K, fresh), np.random.default_rng(seed)
    runs = dimension.simulate_weights(proposal, n, N, rng=rng, n_runs=n_runs, z=np.full(n, z))
    values = np.stack([runs.n_eff, runs.largest_weight, runs.squared_error])
    top = np.exp(np.sort(runs.log_weights[0])[::-1][:TOP])
    return np.c_[values.mean(axis=1), values.std(axis=1, ddof=1) / np.sqrt(n_runs)], top


def _needed(proposal, n, z, counting):
    """N for the error that is asked for, when every scaled innovation is z."""
    factors = np.array([proposal.error_factor(np.full(m, z)) for m in np.atleast_1d(n)])
    return factors / ERROR * (np.atleast_1d(n) if counting == COUNTING[1] else 1.0)


def build(axes):
    """Draw what stays; return the artists that move."""
    o, w, s, e = axes["overlap"], axes["weights"], axes["share"], axes["needed"]
    exact, light = dict(color=COLORS["exact"], ls="--", lw=1.5), dict(color=COLORS["light"], alpha=0.45, lw=0)
    artists = {
        "particles": o.fill_between([0, 1], 0, 0, label="particles", **light),
        "likelihood": o.plot([], [], ":", color=COLORS["measurement"], lw=1.8, label="likelihood")[0],
        "posterior": o.plot([], [], label="posterior", **exact)[0],
        "sticks": w.plot([], [], color=COLORS["particles"], lw=2)[0],
        "heads": w.plot([], [], "o", color=COLORS["particles"], ms=4)[0],
        "n_share": s.axvline(1, color=COLORS["accent"], lw=5, alpha=0.4),
        "edge": s.axvline(1, color=COLORS["measurement"], ls=":", lw=1.4, label="edge of collapse"),
        "share": s.plot([], [], label="share, formula", **exact)[0],
        "bars": s.plot([], [], color=COLORS["particles"], lw=1.0)[0],
        "measured": s.plot([], [], "o", color=COLORS["particles"], ms=4, label="share $N_{eff}/N$")[0],
        "largest": s.plot([], [], "^-", color=COLORS["third"], ms=4.5, lw=1.0, label="largest weight")[0],
        "n_needed": e.axvline(1, color=COLORS["accent"], lw=5, alpha=0.4),
        "N": e.axhline(1, color=COLORS["measurement"], ls=":", lw=1.4, label="N you have"),
        "bootstrap": e.plot([], [], color=COLORS["exact"], ls="--", lw=1.5, label="bootstrap")[0],
        "optimal": e.plot([], [], color=COLORS["second"], ls="-.", lw=1.5, label="optimal")[0],
        "independent": e.plot([], [], color=COLORS["truth"], lw=1.2, label="independent")[0],
        "judged": e.plot([], [], "o", color=COLORS["particles"], ms=4, label="simulated")[0],
    }
    look = dict(handlelength=1.6, labelspacing=0.25)
    o.set(xlim=(-3, 4), ylim=(0, 1.45), yticks=[0, 0.5, 1], ylabel="density / its peak",
          xlabel="state, in sd of the innovation", title="One of the n coordinates")  # fmt: skip
    o.legend(loc="upper center", ncols=3, columnspacing=0.8, **look)
    w.set(xlim=(0, TOP + 1), ylim=(0, 1.05), xticks=[1, 5, 10, 15, 20], xlabel="rank", ylabel="weight",
          title=f"The {TOP} largest weights of one run")  # fmt: skip
    s.set(xlim=(0, 51), ylim=(0, 1.45), yticks=[0, 0.5, 1], xlabel="dimension n",
          title="Share that carries, largest weight")  # fmt: skip
    s.legend(loc="upper center", ncols=2, columnspacing=0.8, **look)
    e.set(xlim=(0, 51), ylim=(0.02, 1e7), yscale="log", yticks=[1e1, 1e3, 1e5, 1e7],
          xlabel="dimension n", ylabel="N", title="N for an error of 5 %")  # fmt: skip
    e.legend(loc="lower center", ncols=3, columnspacing=0.8, borderaxespad=0.1, **look)
    return artists


def update(artists, axes, proposal, n, N, ratio, z, counting, particles):
    """Weigh particles in several dimensions and give the artists their data."""
    kind = PROPOSALS[proposal](q=ratio, r=1.0)
    many = {m: _simulated(kind.K, kind.fresh, m, N, z, particles) for m in sorted({*DIMS, n})}
    edge = np.log(N) / kind.divergence(z)
    _show_overlap(artists, kind.K, z)
    _show_weights(artists, many[n][1])
    _show_share(artists, kind, many, z, n, N, edge)
    _show_needed(artists, many, ratio, z, n, N, counting)
    return _say(proposal, kind, many[n][0], n, N, ratio, z, counting, edge)


def _show_overlap(artists, K, z):
    prior = np.exp(-0.5 * STATE**2 / K)
    artists["particles"].set_verts([np.r_[np.c_[STATE, prior], [[STATE[-1], 0], [STATE[0], 0]]]])
    artists["likelihood"].set_data(STATE, np.exp(-0.5 * (STATE - z) ** 2 / (1.0 - K)))
    artists["posterior"].set_data(STATE, np.exp(-0.5 * (STATE - K * z) ** 2 / (K * (1.0 - K))))


def _show_weights(artists, top):
    rank = np.arange(1, len(top) + 1)
    artists["heads"].set_data(rank, top)
    artists["sticks"].set_data(np.repeat(rank, 3), np.stack([0.0 * top, top, np.nan * top], axis=1).ravel())


def _show_share(artists, kind, many, z, n, N, edge):
    dims = np.array(list(many))
    (mean, se), largest = np.array([s[0] / N for s, _ in many.values()]).T, [s[1, 0] for s, _ in many.values()]
    bars = np.stack([mean - 2 * se, mean + 2 * se, np.nan * mean], axis=1)
    artists["share"].set_data(EVERY, kind.factor(z) ** -EVERY.astype(float))
    artists["bars"].set_data(np.repeat(dims, 3), bars.ravel())
    artists["measured"].set_data(dims, mean)
    artists["largest"].set_data(dims, largest)
    artists["n_share"].set_xdata([n, n])
    artists["edge"].set_xdata([min(edge, 1000.0)] * 2)  # beyond the picture is beyond the picture


def _show_needed(artists, many, ratio, z, n, N, counting):
    for name, make in PROPOSALS.items():
        artists[name].set_data(EVERY, np.minimum(_needed(make(q=ratio, r=1.0), EVERY, z, counting), 1e12))
    artists["independent"].set_data(EVERY, _needed(INDEPENDENT, EVERY, 1.0, counting))
    dims = np.array(list(many))
    judged = np.array([s[2, 0] for s, _ in many.values()]) * N / ERROR
    artists["judged"].set_data(dims, judged * (dims if counting == COUNTING[1] else 1))
    artists["n_needed"].set_xdata([n, n])
    artists["N"].set_ydata([N, N])


def _say(name, kind, simulated, n, N, ratio, z, counting, edge):
    (n_eff, n_eff_se), (largest, largest_se), (error, _) = simulated
    total = n if counting == COUNTING[1] else 1
    limit, needed = N * kind.factor(z) ** -float(n), float(_needed(kind, n, z, counting)[0])
    numbers = {
        "gain K of the weighing": kind.K,
        "factor a coordinate": float(kind.factor(z)),
        "N_eff, formula for many particles": float(limit),
        "N_eff, simulated": float(n_eff),
        "standard error of N_eff": float(n_eff_se),
        "largest weight, simulated": float(largest),
        "standard error of the largest weight": float(largest_se),
        "squared error, simulated": float(error * total),
        "squared error, formula for many particles": needed * ERROR / N,
        "edge of collapse: n": float(edge),
        "N needed, formula": needed,
        "N needed, independent draws": float(_needed(INDEPENDENT, n, 1.0, counting)[0]),
    }
    formula = f"the formula says {limit:.1f}" if limit >= 20 else "too few for the formula, which holds for many"
    sentence = (
        f"{name.capitalize()} proposal, n = {n}, q/r = {ratio:g}, z = {z:g}: a coordinate divides N_eff by "
        f"{kind.factor(z):.3g}. Of {N} particles {n_eff:.1f} are left ({formula}), and the largest weight is "
        f"{largest:.2f}. A squared error of 5 % {counting} takes N = {_count(needed)} by the formula; "
        f"independent draws would need {_count(numbers['N needed, independent draws'])}."
    )
    return Shown(sentence, numbers)


def _count(N):
    """A number of particles, for the eye."""
    if N < 1e5:
        return f"{N:.0f}" if N < 1e3 else f"{float(f'{N:.2g}'):.0f}"
    return f"about 10^{np.log10(N):.0f}"


def _worst_sensor(params, numbers):
    """Whether no other sensor asks more particles of the optimal proposal, by the formula."""
    n, z, counting = params["n"], params["z"], params["counting"]
    make = PROPOSALS["optimal"]
    needed = [_needed(make(q=ratio, r=1.0), n, z, counting)[0] for ratio in CONTROLS[3].values]
    return params["proposal"] == "optimal" and CONTROLS[3].values[np.argmax(needed)] == params["ratio"]


def _collapse_in_one_dimension(params, numbers):
    """Whether a thousand particles of a single coordinate are down to fewer than five."""
    return params["n"] == 1 and params["N"] >= 1000 and numbers["N_eff, simulated"] < 5


PUZZLES = (
    Puzzle(
        "The optimal proposal fears neither the best sensor nor the worst. Take it, and find the q/r at which it needs "
        "the most particles by the formula (at your n and z).",
        _worst_sensor,
        {"proposal": "optimal", "ratio": 0.56},
    ),
    Puzzle(
        "Collapse without the curse: at n = 1, with 1000 particles or more, bring N_eff (simulated) below 5.",
        _collapse_in_one_dimension,
        {"n": 1, "ratio": 100.0, "z": 3.0},
    ),
)


EXPLORER = Explorer(
    title="What each further dimension costs",
    controls=CONTROLS,
    layouts={
        "wide": ((7.6, 5.6), [["overlap", "weights"], ["share", "needed"]]),
        "narrow": ((3.7, 9.4), [["overlap"], ["weights"], ["share"], ["needed"]]),
    },
    build=build,
    update=update,
    also=(
        *({"proposal": "optimal", "n": n} for n in (1, 4, 20, 27, 50)),
        *({"n": 50, "N": N} for N in (10, 100, 10000)),
        *({"proposal": "optimal", "ratio": ratio} for ratio in (0.01, 0.1, 10.0, 100.0)),
        {"n": 1, "counting": COUNTING[1]},
        {"n": 50, "counting": COUNTING[1]},
    ),
    puzzles=PUZZLES,
)
