"""Posteriors from few windows: as wide as what is known of the noise allows, over short and long horizons."""

import numpy as np
import pytest
import torch
from scipy.stats import binom
from scipy.stats import t as student

import nfpde
from nfpde.errors import BadDataset
from nfpde.estimation.trajectory.chains import Chains, Factor
from nfpde.estimation.trajectory.components import Judged, carried_on, kicked
from nfpde.estimation.trajectory.degrees import degrees_left
from nfpde.estimation.trajectory.freedom import Fitted, widening
from nfpde.estimation.trajectory.noise import Scatter
from nfpde.estimation.trajectory.scatter import learn_alike, learn_shared
from tests.linear_robots import SPACE as LINES
from tests.linear_robots import both_stages, linear_simulator, moments

torch.set_num_threads(1)

DT, NOISE = 0.05, 0.003
SPACE = nfpde.ParameterSpace(
    [nfpde.Parameter("mass", low=0.5, high=2.0), nfpde.Parameter("damping", low=0.0, high=1.0)]
)
PROBLEMS = 30


def swing(state, ctrl, xi):
    """A pendulum with a push, its mass and its damping."""
    q, v = state.T
    v = v + DT * (ctrl[:, 0] - xi[:, 1] * v - np.sin(q)) / xi[:, 0]
    return np.column_stack([q + DT * v, v])


def simulator():
    return nfpde.CallableSimulator(swing, SPACE, ["q"], ["v"], ["u"])


def recording(name, xi, rows, rng, sensor=NOISE, kick=0.0):
    """Every state measured with an error, every step with one of its own."""
    u, x = rng.uniform(-1, 1, (rows, 1)), rng.normal(size=(rows, 2))
    for t in range(rows - 1):
        x[t + 1] = swing(x[t : t + 1], u[t : t + 1], xi[None])[0] + kick * rng.normal(size=2)
    x = x + sensor * rng.normal(size=x.shape)
    return nfpde.Episode(name, DT * np.arange(rows), x[:, :1], x[:, 1:], u)


def held(rows, horizon, robots=1, **noise):
    """How often intervals of nine tenths hold the truth, of so many robots in all, and how wide they are."""
    config, inside, widths = nfpde.TrajectoryConfig(horizon=horizon), [], []
    for i in range(PROBLEMS // robots):
        rng = np.random.default_rng([i, 9])
        xi = SPACE.uniform(robots, rng)
        data = nfpde.Dataset([recording(f"{g}", x, rows, rng, **noise) for g, x in enumerate(xi)])
        result = nfpde.fit(simulator(), data, config=config, seed=i, quiet=True)
        for robot, x in zip(result.info["robots"], xi, strict=True):
            found = [robot["parameters"][n] for n in SPACE.names]
            inside += [p["5%"] <= true <= p["95%"] for p, true in zip(found, x, strict=True)]
            widths.append([p["std"] for p in found] / SPACE.width)
    return int(np.sum(inside)), len(inside), np.median(widths, axis=0)


@pytest.mark.parametrize(
    ("rows", "horizon", "robots", "noise"),
    [
        (4, 1, 1, {}),
        (6, 5, 1, {}),
        (61, 30, 1, {}),
        (61, 60, 1, {}),
        (61, 60, 3, {}),
        (61, 30, 1, {"sensor": 0.0, "kick": NOISE}),
    ],
    ids=["three windows", "one short window", "two windows", "one window", "one of each robot", "errors that add up"],
)
def test_intervals_hold_the_truth_as_often_as_they_say(rows, horizon, robots, noise):
    """With less to learn the noise from than any other test has; see docs/results/calibration.md for those with more.

    Both parameters of a robot share its errors, so that the two count as one trial. Of 30 that hold the truth with
    probability 0.9 fewer than 22 do by chance once in 500; in one of these six, once in 80.
    """
    hits, count, widths = held(rows, horizon, robots, **noise)
    assert hits >= binom.ppf(0.003, PROBLEMS, 0.9) / PROBLEMS * count
    # it is told, not given up: a uniform density in the bounds is 0.29 wide
    assert widths.max() < (0.05 if rows > 10 else 0.28)


def test_what_cannot_tell_the_noise_is_refused():
    """Two windows of two parameters that they tell leave nothing; the error says how many, and what to do."""
    data = nfpde.Dataset(moments("one", np.array([1.5, -0.7]), np.random.default_rng(0), count=2, noise=0.01))
    with pytest.raises(BadDataset, match=r"2 windows of 1 control step cannot tell .* the 2 parameters of 1 robot, "):
        nfpde.fit(linear_simulator(), data, quiet=True)


def test_resolutions_of_some_channels_say_nothing_of_the_others():
    """Where two parameters explain the one window there is, all channels need one; those without are named."""
    space = nfpde.ParameterSpace([nfpde.Parameter(name, low=0.0, high=2.0) for name in "ab"])
    pushed = nfpde.CallableSimulator(lambda x, u, xi: x + xi * u, space, ["q"], ["v"], ["u"])
    ends = np.array([[0.0, 0.0], [0.7, 0.9]])
    data = nfpde.Dataset([nfpde.Episode("a", [0, DT], ends[:, :1], ends[:, 1:], np.ones((2, 1)))])
    config = nfpde.TrajectoryConfig(draws=30, population_rounds=1)
    for resolution, said in ((None, ""), ([0.1, 0.0], "of qvel v, too "), ([0.0, 0.1], "of qpos q, too ")):
        with pytest.raises(BadDataset, match=rf"how exact the sensors {said}are \(resolution\)"):
            nfpde.fit(pushed, data, resolution=resolution, config=config, quiet=True)
    assert nfpde.fit(pushed, data, resolution=[0.1, 0.1], config=config, quiet=True).info["noise_freedom"] < 1


def test_a_fit_says_that_few_windows_tell_the_noise():
    """In its results and its report, and not where there are many."""
    rng = np.random.default_rng(1)
    few, many = (
        nfpde.fit(simulator(), nfpde.Dataset([recording("a", np.array([1.0, 0.5]), n, rng)]), quiet=True)
        for n in (7, 60)
    )
    # six windows, and the velocities that tell both parameters: four are left
    assert few.info["noise_freedom"] == pytest.approx(4.0, abs=0.3)
    (words,) = few.info["cautions"]
    assert "degrees of freedom: all intervals are 1.3 times as wide" in words
    assert many.info["noise_freedom"] > 50
    assert many.info["cautions"] == []


@pytest.mark.parametrize("count", [3, 5, 12])
def test_a_posterior_of_few_moments_is_students(count):
    """Of independent windows of a linear system: as wide as the t interval of regression with an unknown variance."""
    rng = np.random.default_rng(count)
    episodes = moments("one", np.array([1.5, -0.7]), rng, count=count, noise=0.01)
    _, together = both_stages(linear_simulator(), nfpde.Dataset(episodes))
    (posterior,) = together.posteriors
    design = 0.1 * np.column_stack([[e.ctrl[0, 0] for e in episodes], np.ones(count)])
    target = np.array([e.qpos[1, 0] - e.qpos[0, 0] for e in episodes])
    best, squares, *_ = np.linalg.lstsq(design, target, rcond=None)
    error = np.sqrt(squares[0] / (count - 2) * np.diag(np.linalg.inv(design.T @ design)))
    half = student.ppf(0.95, count - 2) * error
    assert (half < 0.1 * LINES.width).all(), "the bounds play no part"
    np.testing.assert_allclose(LINES.to_physical(posterior.means[0]), best, atol=0.2 * error.max())
    slope = LINES.width * 0.25 * (1 - np.tanh(posterior.means[0] / 2) ** 2)
    found = 1.6448536 * slope * np.sqrt(np.diag(posterior.covariances[0]))
    np.testing.assert_allclose(found, half, rtol=0.05)


def test_the_widening_is_students():
    """Nine tenths of Student's t are as wide as of a Gaussian with the widened variance; one for sure is itself."""
    for degrees in (1.0, 3.0, 30.0):
        assert 1.6448536 * np.sqrt(widening(degrees)) == pytest.approx(student.ppf(0.95, degrees))
    assert widening(np.inf) == pytest.approx(1.0)
    assert widening(0.1) == widening(1.0)


def dense_covariance(chains, scatter, slopes):
    n, c, ndiff = slopes.shape
    own, shared = scatter.covariances(slopes)
    dense = np.zeros((n, c, n, c))
    for t in range(n):
        dense[t, :, t] = own[t]
        if chains.linked[t]:
            dense[t, :, t - 1, c - ndiff :] = shared[t]
            dense[t - 1, c - ndiff :, t] = shared[t].T
    return dense.reshape(n * c, n * c)


def test_used_freedom_is_that_of_generalised_least_squares():
    """Traces, columns and degrees against dense linear algebra: two robots, three channels, windows in chains."""
    rng, n, c, d = np.random.default_rng(3), 8, 3, 2
    linked = np.array([False, True, True, True, False, True, False, True])
    chains, scatter = Chains.of(linked), Scatter(rng.uniform(0.5, 2, c), np.diag(rng.uniform(0.5, 2, c)))
    slopes, ones = rng.normal(size=(n, c, c)), np.ones(n)
    fitted = Fitted.of([rng.normal(size=(d, 4, c)) for _ in range(2)], np.tile(0.1 * np.eye(d), (2, 1, 1)))
    factor = Factor.of(chains, *scatter.covariances(slopes), ones)
    used = fitted.used(factor, ones, 1.0)
    x = np.zeros((n * c, 2 * d))
    for t in range(n):
        x[t * c : (t + 1) * c, d * (t // 4) : d * (t // 4 + 1)] = fitted.slopes[t]
    # one channel's errors at a time
    parts = []
    for k in range(c):
        only = Scatter(np.where(np.arange(c) == k, scatter.sensor, 0), scatter.process * (np.arange(c) == k))
        parts.append(dense_covariance(chains, only, slopes))
    v = sum(parts)
    solved = np.linalg.solve(v, x)
    left = np.linalg.inv(x.T @ solved + 0.1 * np.eye(2 * d))
    unseen = np.linalg.inv(v) - solved @ left @ solved.T
    assert used.total == pytest.approx(np.trace(x @ left @ solved.T))
    assert used.log_det == pytest.approx(-np.linalg.slogdet(left)[1])
    columns = used.columns.reshape(2, 4 * c, d)
    least = np.inf
    for g in range(2):
        own, mine = slice(g * 4 * c, (g + 1) * 4 * c), slice(d * g, d * (g + 1))
        np.testing.assert_allclose(columns[g] @ columns[g].T, (solved @ left @ solved.T)[own, own], atol=1e-9)
        # directions that are independent both of what the bounds say and of what the windows do
        for a in np.linalg.eigh(left[mine, mine])[1].T:
            told = solved[own, mine] @ left[mine, mine] @ a
            shares = [told @ p[own, own] @ told / (a @ left[mine, mine] @ a) for p in parts]
            freedom = [np.trace(unseen @ p) for p in parts]
            least = min(least, 1 / sum(s**2 / f for s, f in zip(shares, freedom, strict=True)))
    judged = Judged(scatter, 0.0, ones, factor, np.zeros((n, c)), used)
    assert degrees_left(judged, slopes, np.eye(c)) == pytest.approx(least)


def test_errors_of_a_step_are_handed_on():
    """Of a linear system: the covariance at the ends of its steps is that of a random walk through it."""
    rng, ndiff, steps = np.random.default_rng(4), 2, 4
    matrix = np.array([[1.0, 0.1], [-0.3, 0.9]])
    powers = np.concatenate([np.linalg.matrix_power(matrix, h + 1) for h in range(steps)])
    slopes = np.tile(powers, (3, 1, 1))
    variances = np.array([0.5, 2.0])
    errors = np.sqrt(variances) * rng.normal(size=(100_000, steps, ndiff))
    state, ends = np.zeros((len(errors), ndiff)), []
    for h in range(steps):
        state = state @ matrix.T + errors[:, h]
        ends.append(state)
    drawn = np.cov(np.concatenate(ends, axis=1).T)
    # 100 000 draws tell a covariance to half a per cent
    np.testing.assert_allclose(kicked(variances, carried_on(slopes)), drawn, atol=0.03 * drawn.max())
    np.testing.assert_array_equal(carried_on(slopes[:, :ndiff]), np.eye(ndiff))


def test_both_kinds_of_errors_are_told_apart_in_long_windows():
    """Of 60 windows of ten steps, too few for a covariance of their own, errors of a step and of states are found."""
    rng, ndiff, steps, n = np.random.default_rng(5), 2, 10, 60
    matrix = np.array([[1.0, 0.1], [-0.3, 0.9]])
    slopes = np.tile(np.concatenate([np.linalg.matrix_power(matrix, h + 1) for h in range(steps)]), (n, 1, 1))
    start, ends = rng.normal(size=(n, ndiff)), 1.0 * rng.normal(size=(n, steps * ndiff))
    lacks = rng.multivariate_normal(np.zeros(steps * ndiff), kicked(np.array([0.04, 0.25]), carried_on(slopes)), n)
    r = np.einsum("ncd,nd->nc", slopes, start) - ends + lacks
    floors, chains = (np.zeros(ndiff), np.full(steps * ndiff, 1e-9)), Chains.of(np.zeros(n, bool))
    begin = learn_alike([r], 0, floors[1])
    found = learn_shared(begin, r, slopes, chains, Fitted.nothing(n, steps * ndiff), floors).scatter
    # 600 ends tell a variance to 6 %, and those of a step, which show through all that follow, to about 15 %
    np.testing.assert_allclose(found.scale * found.sensor, 1.0, rtol=0.25)
    np.testing.assert_allclose(found.scale * np.diag(found.process)[:ndiff], [0.04, 0.25], rtol=0.6)
