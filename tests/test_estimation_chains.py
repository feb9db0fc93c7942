"""Neighbouring windows share a measured state: the block tridiagonal algebra, and the errors learned through it."""

import mujoco
import numpy as np
import pytest
import torch
from scipy.optimize import minimize

import nfpde
from nfpde.estimation.trajectory.chains import Chains, Factor
from nfpde.estimation.trajectory.freedom import Fitted
from nfpde.estimation.trajectory.noise import Noise, Scatter
from nfpde.estimation.trajectory.problem import make_problem
from nfpde.estimation.trajectory.scatter import learn_alike, learn_shared, smoothed
from nfpde.estimation.trajectory.starts import start_slopes
from nfpde.estimation.trajectory.student import GAUSSIAN
from nfpde.sim import StateSpace

torch.set_num_threads(1)
DT = 0.1
LINKED = np.array([False, True, True, True, False, False, True])


def dense_parts(slopes, linked, horizon):
    """Matrices B and P with residuals = B errors + P process errors, errors of all measured states stacked."""
    n, channels, ndiff = slopes.shape
    columns, starts = [], np.empty(n, int)
    count = 0
    for t in range(n):
        if linked[t]:
            starts[t] = count - 1
        else:
            starts[t], count = count, count + 1
        columns.append(count + np.arange(horizon))
        count += horizon
    b = np.zeros((n * channels, count * ndiff))
    for t in range(n):
        rows = slice(t * channels, (t + 1) * channels)
        b[rows, starts[t] * ndiff : (starts[t] + 1) * ndiff] += slopes[t]
        for h, column in enumerate(columns[t]):
            b[t * channels + h * ndiff : t * channels + (h + 1) * ndiff, column * ndiff : (column + 1) * ndiff] -= (
                np.eye(ndiff)
            )
    return b, starts


@pytest.fixture(params=[1, 2], ids=["one step", "two steps"])
def system(request):
    """A scatter and slopes of seven windows in three chains, and the dense covariance of their residuals."""
    rng, ndiff, h = np.random.default_rng(request.param), 3, request.param
    slopes = rng.normal(size=(len(LINKED), h * ndiff, ndiff))
    root = rng.normal(size=(h * ndiff, h * ndiff))
    scatter = Scatter(rng.uniform(0.5, 2.0, ndiff), 0.3 * root @ root.T)
    b, starts = dense_parts(slopes, LINKED, h)
    sensor = np.tile(scatter.sensor, b.shape[1] // ndiff)
    covariance = (b * sensor) @ b.T + np.kron(np.eye(len(LINKED)), scatter.process)
    return scatter, slopes, b, starts, sensor, covariance


def test_the_factor_is_that_of_the_dense_covariance(system):
    """Solutions, determinant, blocks of the inverse and white innovations equal those of dense linear algebra."""
    scatter, slopes, _, _, _, covariance = system
    chains = Chains.of(LINKED)
    n, c = slopes.shape[:2]
    r = np.random.default_rng(3).normal(size=(n, c))
    ones = np.ones(n)
    own, shared = scatter.covariances(slopes)
    factor = Factor.of(chains, own, shared, ones)
    solution = factor.solution(factor.innovations(r), ones)
    diagonal, below = factor.inverse_blocks(ones)
    inverse = np.linalg.inv(covariance)
    blocks = inverse.reshape(n, c, n, c)
    np.testing.assert_allclose(solution.ravel(), inverse @ r.ravel(), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(np.linalg.slogdet(factor.spread)[1].sum(), np.linalg.slogdet(covariance)[1], rtol=1e-12)
    for t in range(n):
        np.testing.assert_allclose(diagonal[t], blocks[t, :, t], rtol=1e-9, atol=1e-12)
        expected = blocks[t, :, t - 1] if LINKED[t] else np.zeros((c, c))
        np.testing.assert_allclose(below[t], expected, rtol=1e-9, atol=1e-12)
    noise = Noise.of(scatter, slopes, chains, ones, [np.arange(n)])
    assert (noise.whiten(0, r) ** 2).sum() == pytest.approx(r.ravel() @ inverse @ r.ravel(), rel=1e-10)


def test_a_window_of_no_weight_counts_as_not_recorded(system):
    """The innovations after it are those of the covariance without its rows."""
    scatter, slopes, _, _, _, covariance = system
    n, c = slopes.shape[:2]
    weights = np.ones(n)
    weights[1] = 0.0
    r = np.random.default_rng(4).normal(size=(n, c))
    noise = Noise.of(scatter, slopes, Chains.of(LINKED), weights, [np.arange(n)])
    white = noise.whiten(0, r)
    rows = np.flatnonzero(np.repeat(weights, c))
    left = r.ravel()[rows] @ np.linalg.solve(covariance[np.ix_(rows, rows)], r.ravel()[rows])
    # what was not recorded tells nothing of the next window, whatever stands in its place
    assert (np.delete(white, 1, 0) ** 2).sum() == pytest.approx(left, rel=1e-10)
    r[1] = np.nan
    again = noise.whiten(0, r)
    np.testing.assert_allclose(np.delete(again, 1, 0), np.delete(white, 1, 0), rtol=1e-10)
    assert np.isnan(again[1]).all()


def test_errors_of_the_starts_are_the_conditional_mean(system):
    """What is said of each start's error is its Gaussian expectation given all residuals of its chain."""
    scatter, slopes, b, starts, sensor, covariance = system
    r = np.random.default_rng(5).normal(size=slopes.shape[:2])
    weights, errors, left = smoothed(scatter, Chains.of(LINKED), slopes, r)
    mean = sensor * (b.T @ np.linalg.solve(covariance, r.ravel()))
    variance = sensor - np.diag((sensor[:, None] * b.T) @ np.linalg.solve(covariance, b * sensor))
    ndiff = len(scatter.sensor)
    np.testing.assert_allclose(errors, mean.reshape(-1, ndiff)[starts], rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(left**2, variance.reshape(-1, ndiff)[starts].mean(0), rtol=1e-5)
    assert (weights > 0.999).all()


def linear_records(rng, sensor, process, rows, slope):
    """Residuals of a linear system at its true parameters: G e_t - e_(t+1) + w_t."""
    e = sensor * rng.normal(size=(rows + 1, len(sensor)))
    w = rng.normal(size=(rows, len(sensor))) @ np.linalg.cholesky(process).T
    return e[:-1] @ slope.T - e[1:] + w


@pytest.mark.parametrize(("sensor", "size"), [((1.0, 0.3), 0.2), ((0.2, 0.2), 1.0)], ids=["sensors", "simulation"])
def test_both_kinds_of_errors_are_told_apart(sensor, size):
    """Variances of the states' errors and of the simulation's are recovered from 3000 windows, full and correlated."""
    rng = np.random.default_rng(6)
    slope = np.array([[1.0, DT], [-0.5, 0.9]])
    process = size**2 * np.array([[1.0, 0.6], [0.6, 1.0]])
    r = linear_records(rng, np.array(sensor), process, 3000, slope)
    slopes = np.tile(slope, (3000, 1, 1))
    chains = Chains.of(np.arange(3000) > 0)
    floor = np.full(2, 1e-9)
    floors, fitted = (np.zeros(2), floor), Fitted.nothing(3000, 2)
    found = learn_shared(learn_alike([r], 0, floor), r, slopes, chains, fitted, floors).scatter
    # 3000 windows tell the sum of both to 3 %, and each of them to some 5 % of that sum
    total = np.array(sensor) ** 2 + np.diag(process)
    np.testing.assert_allclose(found.scale * found.sensor, np.square(sensor), atol=0.15 * total.max())
    np.testing.assert_allclose(found.scale * found.process, process, atol=0.15 * total.max())
    assert found.degrees >= 50


def test_many_robots_use_up_no_more_freedom_than_they_have():
    """Of 600 robots with six parameters each some of the windows tell the variance, and what all lose counts there.

    Residuals of a fit that took 3600 of 24 000 degrees of freedom scatter by 0.85 of the variance, which is 1.
    """
    rng = np.random.default_rng(8)
    robots, windows, d = 600, 20, 6
    n = robots * windows
    x = rng.normal(size=(robots, d, windows, 2))
    columns = x.reshape(robots, d, 2 * windows).swapaxes(1, 2)
    r = rng.normal(size=(robots, 2 * windows, 1))
    r -= columns @ (np.linalg.pinv(columns) @ r)
    fitted = Fitted.of(list(x), np.tile(1e-6 * np.eye(d), (robots, 1, 1)))
    floor, r = np.full(2, 1e-9), r.reshape(n, 2)
    chains = Chains.of(np.arange(n) % windows > 0)
    start = learn_alike([r], robots * d, floor)
    found = learn_shared(start, r, np.zeros((n, 2, 2)), chains, fitted, (np.zeros(2), floor))
    total = found.scatter.scale * (found.scatter.sensor + np.diag(found.scatter.process))
    # 3000 windows tell a variance to 2.6 %
    np.testing.assert_allclose(total, 1.0, atol=0.1)
    # each of both channels has lost half of what was lost there: of 2500 windows that tell a variance 0.15 are gone
    assert 2300 < found.scatter.freedom < 5200


def test_outliers_end_up_in_the_tails():
    """A tenth of wild windows lowers the degrees of freedom and tells the next windows little; the errors stay."""
    rng = np.random.default_rng(7)
    slope, n = np.array([[1.0, DT], [-0.5, 0.9]]), 2000
    r = linear_records(rng, np.ones(2), 0.01 * np.eye(2), n, slope)
    wild = np.arange(5, n, 10)
    r[wild] += 100.0 * rng.normal(size=(len(wild), 2))
    floor = np.full(2, 1e-9)
    chains = Chains.of(np.arange(n) > 0)
    floors, fitted = (np.zeros(2), floor), Fitted.nothing(n, 2)
    found = learn_shared(learn_alike([r], 0, floor), r, np.tile(slope, (n, 1, 1)), chains, fitted, floors)
    assert found.scatter.degrees <= 4
    assert np.median(found.weights[wild]) < 0.01 < 0.5 < np.median(np.delete(found.weights, wild))
    sizes = np.sqrt(found.scatter.scale * found.scatter.sensor)
    assert (sizes < 3).all()
    assert (sizes > 0.3).all()


def test_a_kind_of_error_grows_from_nothing():
    """While parameters are wrong the simulation takes all; when they are right the sensors get back what is theirs."""
    rng, n, slope = np.random.default_rng(9), 200, np.array([[1.0, DT], [-0.5, 0.9]])
    r = linear_records(rng, np.ones(2), 1e-6 * np.eye(2), n, slope)
    chains, slopes, floors = Chains.of(np.arange(n) > 0), np.tile(slope, (n, 1, 1)), (np.zeros(2), np.full(2, 1e-9))
    asleep = Scatter(np.full(2, 1e-18), 2 * np.eye(2))
    found = learn_shared(asleep, r, slopes, chains, Fitted.nothing(n, 2), floors).scatter
    # 200 windows tell a variance to a tenth
    np.testing.assert_allclose(found.scale * found.sensor, 1.0, rtol=0.4)
    assert (found.scale * np.diag(found.process) < 0.05).all()


def test_the_likeliest_sizes_are_found_to_the_end():
    """As likely as any that a general optimiser finds from there, of windows and a fit like those of a short recording.

    A few steps of a random walk beside the errors of states are next to nothing in a window, and matter to a posterior.
    """
    rng, n, slope = np.random.default_rng(12), 60, np.array([[1.0, DT], [-0.5, 0.9]])
    x = rng.normal(size=(1, 2, n, 2))
    r = linear_records(rng, np.ones(2), 1e-3 * np.eye(2), n, slope)
    chains, slopes, floors = Chains.of(np.arange(n) > 0), np.tile(slope, (n, 1, 1)), (np.zeros(2), np.full(2, 1e-9))
    fitted, ones = Fitted.of(list(x), 0.1 * np.eye(2)[None]), np.ones(n)

    def cost(logs):
        sensor, process = np.split(np.exp(np.clip(logs, -25, 5)), 2)
        factor = Factor.of(chains, *Scatter(sensor, np.diag(process)).covariances(slopes), ones)
        innovations = factor.innovations(r)
        squares = np.einsum("ni,nij,nj->", innovations, factor.inverse, innovations)
        return 0.5 * (squares + np.linalg.slogdet(factor.spread)[1].sum() + fitted.used(factor, ones, 1.0).log_det)

    found = learn_shared(learn_alike([r], 2, floors[1]), r, slopes, chains, fitted, floors).scatter
    assert found.degrees == GAUSSIAN
    logs = np.log(np.maximum(found.scale * np.concatenate([found.sensor, np.diag(found.process)]), 1e-11))
    best = minimize(cost, logs, method="Nelder-Mead", options={"maxiter": 2000, "fatol": 1e-4})
    assert cost(logs) - best.fun < 0.1


def test_correlations_are_not_believed_by_chance():
    """Of ten windows whose errors have none they are seldom found, and of a hundred that have them always."""
    floors, slope = (np.zeros(2), np.full(2, 1e-9)), np.zeros((2, 2))
    root = np.linalg.cholesky(np.array([[1.0, 0.8], [0.8, 1.0]]))

    def correlated(rng, n, root):
        r = rng.normal(size=(n, 2)) @ root.T
        chains, slopes = Chains.of(np.zeros(n, bool)), np.tile(slope, (n, 1, 1))
        found = learn_shared(learn_alike([r], 0, floors[1]), r, slopes, chains, Fitted.nothing(n, 2), floors)
        return found.scatter.process[0, 1] != 0

    rng = np.random.default_rng(10)
    # once in a hundred, or somewhat more often in as few as these: six of 60 are six standard deviations above that
    assert sum(correlated(rng, 10, np.eye(2)) for _ in range(60)) <= 6
    assert all(correlated(rng, 100, root) for _ in range(10))


def test_errors_never_fall_below_their_floors():
    """Perfect residuals leave the floors."""
    slopes, floors = np.tile(np.eye(2), (50, 1, 1)), (np.full(2, 1e-3), np.full(2, 1e-9))
    chains = Chains.of(np.arange(50) > 0)
    zero = np.zeros((50, 2))
    start = learn_alike([zero], 0, floors[1])
    found = learn_shared(start, zero, slopes, chains, Fitted.nothing(50, 2), floors).scatter
    np.testing.assert_allclose(found.scale * found.sensor, 1e-6, rtol=0.01)
    assert np.linalg.eigvalsh(found.scale * found.process).min() >= 0.999e-18


@pytest.mark.parametrize("horizon", [1, 3])
def test_slopes_by_the_start_are_powers_of_the_system(horizon):
    """In a linear system the end of step h moves by the h-th power of its matrix, whatever the size of the step."""
    matrix = np.array([[1.0, DT], [-0.5, 0.9]])
    space = nfpde.ParameterSpace([nfpde.Parameter("gain", low=0.0, high=2.0)])
    simulator = nfpde.CallableSimulator(lambda x, u, xi: x @ matrix.T + xi * u, space, ["x"], ["v"])
    rng = np.random.default_rng(8)
    episode = nfpde.Episode(
        "a", DT * np.arange(13), rng.normal(size=(13, 1)), rng.normal(size=(13, 1)), rng.normal(size=(13, 1))
    )
    problem = make_problem(simulator, nfpde.Dataset([episode]), horizon)
    found = start_slopes(problem, np.zeros((1, 1)), np.array([1e-3, 0.5]))
    unit = problem.unit[:2]
    for h in range(horizon):
        power = np.linalg.matrix_power(matrix, h + 1) * unit / unit[:, None]
        np.testing.assert_allclose(
            found[:, 2 * h : 2 * h + 2], np.tile(power, (len(found), 1, 1)), rtol=1e-9, atol=1e-9
        )


def test_states_move_as_mujoco_moves_them():
    """Moved states are mj_integratePos, and the difference of a moved state is the step, quaternions included."""
    xml = """<mujoco><worldbody><body><freejoint/><geom size=".1"/>
    <body pos="0 0 1"><joint type="ball"/><geom size=".1"/>
    <body pos="0 0 1"><joint type="slide"/><geom size=".1"/></body></body></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    states, rng = StateSpace.of_model(model), np.random.default_rng(9)
    state = rng.normal(size=(20, model.nq + model.nv))
    for q, _ in states.quaternions:
        state[:, q : q + 4] /= np.linalg.norm(state[:, q : q + 4], axis=1, keepdims=True)
    step = rng.uniform(-1, 1, (20, 2 * model.nv))
    step[0] = 0.0
    found = states.moved(state, step)
    for row, move, end in zip(state, step, found, strict=True):
        qpos = row[: model.nq].copy()
        mujoco.mj_integratePos(model, qpos, move[: model.nv], 1.0)
        np.testing.assert_allclose(end[: model.nq], qpos, atol=1e-14)
    np.testing.assert_allclose(states.difference(found, state), step, atol=1e-13)


def noisy_decay(rng, rate, sensor, rows=60):
    """A decaying state with a random push, every state measured with an error."""
    u, x = rng.normal(size=(rows, 1)), np.zeros((rows, 1))
    for t in range(rows - 1):
        x[t + 1] = rate * x[t] + 0.5 * u[t]
    return x + sensor * rng.normal(size=x.shape), u


def test_noisy_starts_do_not_bias_the_estimate():
    """Regression on a noisy state shrinks its coefficient; the estimator does not, and its errors are as it says."""
    rng, rates, sensor = np.random.default_rng(10), np.random.default_rng(11).uniform(0.6, 0.95, 40), 0.3
    episodes, naive = [], []
    for i, rate in enumerate(rates):
        x, u = noisy_decay(rng, rate, sensor)
        episodes.append(nfpde.Episode(f"{i}", DT * np.arange(len(x)), x, np.empty((len(x), 0)), u))
        target = x[1:] - 0.5 * u[:-1]
        naive.append(float((x[:-1] * target).sum() / (x[:-1] ** 2).sum()))
    space = nfpde.ParameterSpace([nfpde.Parameter("rate", low=0.2, high=1.2)])
    simulator = nfpde.CallableSimulator(lambda x, u, xi: xi * x + 0.5 * u, space, ["x"])
    config = nfpde.TrajectoryConfig(population_rounds=1)
    result = nfpde.fit(simulator, nfpde.Dataset(episodes), config=config, quiet=True)
    rows = [r["parameters"]["rate"] for r in result.info["robots"]]
    error = np.array([r["value"] for r in rows]) - rates
    z = error / np.array([r["std"] for r in rows])
    assert np.mean(np.array(naive) - rates) < -0.1
    # the mean of 40 errors is within four of its standard errors of zero
    assert abs(error.mean()) < 4 * error.std() / np.sqrt(40)
    # 40 squares of standard normals: their mean is outside 0.5 to 1.7 once in a thousand
    assert 0.5 < (z**2).mean() < 1.7
