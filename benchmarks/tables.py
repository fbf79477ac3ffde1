"""The book's reference numbers, measured anew: ``make tables``, or ``python benchmarks/tables.py [names] [--share S]``.

Beside each stands what was found by other programs (Octave and plain numpy, written from the sources), and how far
that is from what is measured here, in standard errors of the latter. Records and seeds differ. ``--share 0.1`` makes
a tenth of the runs.
"""

import argparse
import functools
from concurrent.futures import ProcessPoolExecutor

import numpy as np

import pfedu
from pfedu import models
from pfedu.resampling import always, never
from pfedu.studies import particles_needed, study

GRID = np.linspace(-60.0, 60.0, 961)
T = 50


def fresh(model, n_runs, rng, T=T):
    """Truths and records of their own for each run, the first measurement not used, and the exact answer."""
    x, y = model.simulate(T, rng, n_runs=n_runs)
    y[:, 0] = np.nan
    return x, y, pfedu.kalman_filter(model, y) if hasattr(model, "F") else pfedu.grid_filter(model, y, GRID)


def deviation(track, exact):
    """RMS deviation from the exact mean over steps 1 to T: (runs,)."""
    return np.sqrt(np.mean((track.mean - exact.mean)[:, 1:, 0] ** 2, axis=-1))


# -- what a bootstrap filter of N particles does ------------------------------------------------------------------


def bootstrap(n_runs, rng, system, N, policy=always):
    model = {"linear": models.random_walk, "growth": models.growth}[system]()
    x, y, exact = fresh(model, n_runs, rng)
    track = pfedu.bootstrap_filter(model, y, N, rng=rng, policy=policy)
    error = track.log_likelihood - exact.log_likelihood
    return {"deviation": deviation(track, exact), "N_eff": track.n_eff[:, 1:].mean(axis=-1), "log-likelihood": error,
            "spread": (error - error.mean()) ** 2, "RMSE": np.sqrt(np.mean((track.mean - x)[:, 1:, 0] ** 2, axis=-1)),
            "exact RMSE": np.sqrt(np.mean((exact.mean - x)[:, 1:, 0] ** 2, axis=-1))}  # fmt: skip


def bootstrap_table(run):
    deviations = {"linear": {100: 0.229, 500: 0.0920, 1000: 0.0620, 5000: 0.0264},
                  "growth": {100: 1.70, 500: 0.624, 1000: 0.488, 5000: 0.218, 20000: 0.099}}  # fmt: skip
    for system, wanted in deviations.items():
        for N, value in wanted.items():
            got = run(bootstrap, 2_000_000 // N if N < 1000 else 400_000 // N, batch=max(1, 200_000 // N),
                      system=system, N=N)  # fmt: skip
            yield f"{system}, N = {N}: RMS deviation from the exact mean", value, got["deviation"]
            if N == 500:
                others = {"linear": (-0.44, 143.4), "growth": (-1.2, 184.6)}[system]
                yield f"{system}, N = 500: log-likelihood error", others[0], got["log-likelihood"]
                yield f"{system}, N = 500: N_eff", others[1], got["N_eff"]
                if system == "growth":
                    yield "growth, N = 500: RMSE against truth", 4.539, got["RMSE"]
                    yield "growth, exact: RMSE against truth", 4.486, got["exact RMSE"]


def gaussian(n_runs, rng, name, options):
    x, y, _ = fresh(models.growth(), n_runs, rng, T)
    track = getattr(pfedu, f"{name}_kalman_filter")(models.growth(), y, **options)
    return {"RMSE": np.sqrt(np.mean((track.mean - x)[:, 1:, 0] ** 2, axis=-1))}


def gaussian_table(run):
    julier = dict(alpha=1.0, beta=0.0, kappa=2.0)  # n + kappa = 3; the lecture's 1, 2, 0 give 7.8
    for name, value, options in (("extended", 20.1, {}), ("unscented", 11.1, julier)):
        got = run(gaussian, 2000, batch=200, name=name, options=options)
        yield f"growth, {name} {options or ''}: RMSE against truth", value, got["RMSE"]


# -- the falling body: 100 Monte Carlo runs, and more --------------------------------------------------------------

TRUTH = (3e5, 2e4, 1e-3)
UNSCENTED_PRIOR = dict(m0=(3e5, 2e4, 3e-5), P0=(1e6, 4e6, 1e-4))


def falling_body(n_runs, rng, N=500):
    model = models.falling_body()
    x, y = model.simulate(60, rng, n_runs=n_runs, x0=TRUTH)
    y[:, 0] = np.nan
    particles = pfedu.regularized_filter(model, y, N, rng=rng, kernel="gaussian")
    points = pfedu.unscented_kalman_filter(models.falling_body(**UNSCENTED_PRIOR), y, noise="augmented")
    return {"particles": np.abs(particles.mean - x), "unscented": np.abs(points.mean - x)}


def falling_body_table(run):
    got = run(falling_body, 1000, batch=250)
    particles = {15: (128, 21.2, 9.4e-6), 20: (72.7, 3.33, 4.9e-6), 60: (24.2, 0.294, 5.0e-6)}
    unscented = {15: (122, 68, 2.6e-5), 20: (72, 9.8, 9.8e-6), 60: (23, 0.31, 4.9e-6)}
    for t, values in particles.items():
        for j, value in enumerate(values):
            yield f"falling body, t = {t}: mean error of x{j + 1}, particles", value, _part(got["particles"], t, j)
    for t, values in unscented.items():
        for j, value in enumerate(values):
            errors = got["unscented"].values[:, t, j]
            yield f"falling body, t = {t}: median error of x{j + 1}, unscented", value, float(np.median(errors))


def _part(summary, t, j):
    return type(summary)(summary.values[:, t, j])


# -- van der Pol's oscillator ----------------------------------------------------------------------------------------


@functools.cache
def oscillation(steps=100, dt=0.05, fine=100):
    """The truth of the example: the differential equation from (2, 0), by small Runge-Kutta steps."""
    x, h, path = np.array([2.0, 0.0]), dt / fine, [[2.0, 0.0]]

    def slope(x):
        return np.array([x[1], (1 - x[0] ** 2) * x[1] - x[0]])

    for k in range(1, steps * fine + 1):
        a = slope(x)
        b = slope(x + h / 2 * a)
        c = slope(x + h / 2 * b)
        x = x + h / 6 * (a + 2 * b + 2 * c + slope(x + h * c))
        if k % fine == 0:
            path.append(x)
    return np.array(path)


def oscillator(n_runs, rng, r):
    x = oscillation()
    y = x[:, :1] + 0.04 * rng.standard_normal((n_runs, len(x), 1))
    track = pfedu.bootstrap_filter(models.van_der_pol(r=r), y, 1000, rng=rng)
    error = np.sqrt(np.mean((track.mean - x) ** 2, axis=1))
    return {"x1": error[:, 0], "x2": error[:, 1], "resamplings": track.resampled.sum(axis=-1)}


def oscillator_table(run):
    for r, values in {0.016: (0.01956, 0.04615, 11.1), 0.0016: (0.02334, 0.0671, 37.5)}.items():
        got = run(oscillator, 1000, batch=100, r=r)
        for name, value in zip(("x1", "x2", "resamplings"), values, strict=True):
            yield f"van der Pol, r = {r}: {'RMSE of ' if name[0] == 'x' else ''}{name}", value, got[name]


# -- better proposals --------------------------------------------------------------------------------------------------


def proposal(n_runs, rng, system, name, N, options):
    model = {"linear": models.random_walk, "growth": models.growth}[system]()
    _, y, exact = fresh(model, n_runs, rng)
    track = getattr(pfedu, f"{name}_filter")(model, y, N, rng=rng, policy=always, **options)
    return {"deviation": deviation(track, exact)}


def proposals_table(run):
    rows = [("linear", "bootstrap", {}, 0.178), ("linear", "local_linear", {}, 0.0707),
            ("growth", "bootstrap", {}, 1.22), ("growth", "local_linear", {}, 0.77),
            ("growth", "local_linear", {"proposal": "ukf"}, 0.62),
            ("growth", "local_linear", {"proposal": "ukf", "carry": True}, 1.29)]  # fmt: skip
    for system, name, options, value in rows:
        got = run(proposal, 1000, batch=100, system=system, name=name, N=200, options=options)
        yield f"{system}, N = 200: {name} {options or ''}", value, got["deviation"]


def looking_ahead(n_runs, rng, q, name):
    model = models.random_walk(q=q)
    _, y, exact = fresh(model, n_runs, rng)
    track = getattr(pfedu, f"{name}_filter")(model, y, 500, rng=rng, policy=always)
    return {"N_eff": track.n_eff[:, 1:].mean(axis=-1), "deviation": deviation(track, exact)}


def auxiliary_table(run):
    for q, values in {0.01: (446, 495), 0.1: (397, 457), 1.0: (293, 261), 10.0: (143, 63)}.items():
        for name, value in zip(("bootstrap", "auxiliary"), values, strict=True):
            got = run(looking_ahead, 500, batch=100, q=q, name=name)
            yield f"linear, q = {q}: N_eff, {name}", value, got["N_eff"]
            if q == 10.0:
                deviations = {"bootstrap": 0.092, "auxiliary": 0.256}
                yield f"linear, q = {q}: deviation, {name}", deviations[name], got["deviation"]


def sharp_measurement(n_runs, rng, name):
    model = models.ratio(q=1.0, r=0.01, power=2)
    y = model.simulate(T, rng, n_runs=n_runs)[1]
    y[:, 0] = np.nan
    exact = pfedu.grid_filter(model, y, np.linspace(-15.0, 15.0, 1801))
    track = getattr(pfedu, f"{name}_filter")(model, y, 500, rng=rng, policy=always)
    return {"N_eff": track.n_eff[:, 1:].mean(axis=-1), "deviation": deviation(track, exact)}


def optimal_table(run):
    for name, (n_eff, error) in {"optimal": (498, 0.0044), "bootstrap": (50, 0.0198)}.items():
        got = run(sharp_measurement, 400, batch=100, name=name)
        yield f"x²/(1+x²), q = 1, r = 0.01: N_eff, {name}", n_eff, got["N_eff"]
        yield f"x²/(1+x²), q = 1, r = 0.01: deviation, {name}", error, got["deviation"]


# -- what dimension costs ---------------------------------------------------------------------------------------------


def dimension_error(N, n, name, n_runs):
    """Mean of |m_PF - m_KF|² / (n P) over runs and the later half of the steps."""
    model = models.copies(models.random_walk(q=1.0, r=1.0, p0=1.0), n)
    rng = np.random.default_rng([n, 7])
    total, part = 0.0, max(1, 2_000_000 // (N * n))
    for begin in range(0, n_runs, part):
        runs = min(part, n_runs - begin)
        y = model.simulate(20, rng, n_runs=runs)[1]
        exact = pfedu.kalman_filter(model, y)
        track = getattr(pfedu, f"{name}_filter")(model, y, N, rng=rng, policy=always)
        total += np.sum((track.mean - exact.mean)[:, 10:] ** 2) / exact.cov[0, -1, 0, 0]
    return total / (n_runs * 11 * n)


def dimension_table(run):
    wanted = {"bootstrap": {1: 56, 2: 103, 4: 480, 6: 1970, 8: 8860, 10: 18300},
              "optimal": {1: 30, 2: 37, 4: 68, 6: 107, 8: 166, 10: 273, 12: 381, 16: 1050, 20: 2300}}  # fmt: skip
    for name, row in wanted.items():
        for n, value in row.items():
            runs = max(8, int(run.share * min(200, 400_000 // value)))
            needed = particles_needed(lambda N: dimension_error(N, n, name, runs), 0.05, start=20)  # noqa: B023
            yield f"{n} random walks, {name}: N for an error of 5 %", value, float(needed)


# -- Rao-Blackwellisation ---------------------------------------------------------------------------------------------


def modes_by_enumeration(model, y):
    """Exact means of z of two modes and the same gain: all sequences of modes, for records (runs, K+1, d)."""
    runs, K, d = len(y), y.shape[1] - 1, model.n_z
    a, q, r = model.A[0, 0, 0], model.Q[0, 0, 0], model.R[0, 0, 0]
    m, log_p, P = np.zeros((runs, 1, d)), np.zeros((runs, 1)), 1.0
    last, means = np.array([0, 1]), []
    for k in range(1, K + 1):
        sign, s = np.array([1.0, -1.0]), np.array([0, 1])
        if k == 1:
            log_jump = np.log(np.full((1, 2), 0.5))
        else:
            log_jump = np.log(model.Pi[last][:, s])  # (sequences, 2)
        P_minus = a * a * P + q
        S, gain = P_minus + r, P_minus / (P_minus + r)
        m_minus = (a * m[:, :, None, :] * sign[:, None]).reshape(runs, -1, d)
        e = y[:, k, None, :] - m_minus
        log_p = (log_p[:, :, None] + log_jump).reshape(runs, -1) - 0.5 * np.sum(e * e, axis=-1) / S
        m, P, last = m_minus + gain * e, P_minus * (1 - gain), np.tile(s, m_minus.shape[1] // 2)
        w = np.exp(log_p - log_p.max(axis=1, keepdims=True))
        means.append(np.einsum("rs,rsd->rd", w / w.sum(axis=1, keepdims=True), m))
    return np.stack(means, axis=1)


def conditionally_exact(n_runs, rng, d, name, N):
    model = models.jump_markov(d)
    y = model.simulate(10, rng, n_runs=n_runs)[1]
    y[:, 0] = np.nan
    track = getattr(pfedu, f"{name}_filter")(model, y, N, rng=rng)
    error = track.mean[:, 1:, 1:] - modes_by_enumeration(model, y)
    return {"MSE": np.mean(error**2, axis=(1, 2))}


def rao_blackwell_table(run):
    wanted = {("rao_blackwellized", 200): (4.1e-4, 1.5e-4, 2.2e-5, 8e-6),
              ("bootstrap", 10_000): (9.6e-4, 5e-3, 0.046, 0.20)}  # fmt: skip
    for (name, N), row in wanted.items():
        for d, value in zip((1, 4, 8, 12), row, strict=True):
            got = run(conditionally_exact, 400, batch=50 if N == 200 else 5, d=d, name=name, N=N)
            yield f"jump-Markov, d = {d}: MSE per dimension, {name}({N})", value, got["MSE"]


# -- regularisation ---------------------------------------------------------------------------------------------------


def parameter(n_runs, rng, name, options):
    model = models.random_walk(q=0.0, r=1.0, p0=1.0)
    y = model.simulate(50, rng, n_runs=n_runs)[1]
    y[:, 0] = np.nan
    track = getattr(pfedu, f"{name}_filter")(model, y, 500, rng=rng, keep=True, **options)
    distinct = [len(np.unique(p)) for p in track.particles[:, -1, :, 0]]
    return {"distinct": np.array(distinct), "variance": track.cov[:, -1, 0, 0] * 51}


def regularised_table(run):
    got = run(parameter, 400, batch=100, name="bootstrap", options={})
    yield "static parameter: distinct values of 500, SIR", 121, got["distinct"]
    for shrink, value in ((False, 1.073), (True, 0.997)):
        got = run(parameter, 400, batch=100, name="regularized", options={"kernel": "gaussian", "shrink": shrink})
        yield f"static parameter: variance over exact, shrink={shrink}", value, got["variance"]


# -- faults, and what they cost ---------------------------------------------------------------------------------------


def used_twice(n_runs, rng, N):
    model = models.random_walk()
    _, y, exact = fresh(model, n_runs, rng)
    track = pfedu.kalman_bank_filter(model, y, N, rng=rng, use_twice=True)
    return {"deviation": deviation(track, exact), "variance": np.mean((track.cov / exact.cov)[:, 1:], axis=(1, 2, 3))}


def without_resampling(n_runs, rng):
    model = models.ratio()
    y = model.simulate(T, rng, n_runs=n_runs)[1]
    y[:, 0] = np.nan
    return {"N_eff": pfedu.optimal_filter(model, y, 500, rng=rng, policy=never).n_eff[:, -1]}


def faults_table(run):
    for N in (500, 5000):
        got = run(used_twice, 200, batch=20, N=N)
        yield f"bank that uses y twice, N = {N}: deviation", 0.260, got["deviation"]
        yield f"bank that uses y twice, N = {N}: variance over exact", 0.007, got["variance"]
    yield "optimal density, never resampled: N_eff of 500", 125, run(without_resampling, 400, batch=100)["N_eff"]


TABLES = {"bootstrap": bootstrap_table, "gaussian": gaussian_table, "falling-body": falling_body_table,
          "oscillator": oscillator_table, "proposals": proposals_table, "auxiliary": auxiliary_table,
          "optimal": optimal_table, "dimension": dimension_table, "rao-blackwell": rao_blackwell_table,
          "regularised": regularised_table, "faults": faults_table}  # fmt: skip


def runner(share, map):
    def run(measure, n_runs, batch, **setting):
        (result,) = study(measure, [setting], n_runs=max(8, int(share * n_runs)), batch=batch,
                          rng=np.random.default_rng(20), map=map)  # fmt: skip
        return result

    run.share = share
    return run


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tables", nargs="*", choices=[[], *TABLES], help=f"which: {', '.join(TABLES)}; all by default")
    parser.add_argument("--share", type=float, default=1.0, help="share of the runs to make")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    print(f"{'':58s} {'elsewhere':>10s} {'here':>10s} {'± s.e.':>9s} {'distance':>9s}")
    with ProcessPoolExecutor(options.processes) as pool:
        run = runner(options.share, pool.map)
        for name in options.tables or TABLES:
            for label, value, got in TABLES[name](run):
                if isinstance(got, float):
                    print(f"{label:58s} {value:10.4g} {got:10.4g} {'':9s} {got / value - 1:+8.0%}", flush=True)
                else:
                    mean, error = float(got.mean), float(got.standard_error)
                    print(f"{label:58s} {value:10.4g} {mean:10.4g} {error:9.2g} {(mean - value) / error:+7.1f} se",
                          flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
