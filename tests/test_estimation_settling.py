"""Parameters and errors of the starts in turn: against dense algebra, and against a joint least-squares fit."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.special import log_expit

import nfpde
from nfpde.benchmarks import collect, robot
from nfpde.benchmarks.sensing import with_noise
from nfpde.estimation.trajectory import TrajectoryEstimator
from nfpde.estimation.trajectory.chains import Chains
from nfpde.estimation.trajectory.levenberg import UNSEEN
from nfpde.estimation.trajectory.noise import Scatter
from nfpde.estimation.trajectory.problem import make_problem
from nfpde.estimation.trajectory.settling import TURNS, Linear, Linearised, settle

DT, SENSOR, PROCESS, ROWS = 0.2, 0.05, 0.02, 30
SPACE = nfpde.ParameterSpace([nfpde.Parameter("rate", low=-10.0, high=10.0)])


def decaying(x, u, xi):
    """Linear in the state and in the parameter."""
    return 0.9 * x + DT * xi * u


def swinging(x, u, xi):
    """Linear in neither."""
    return x - DT * xi * np.sin(2 * x) + DT * u


def recorded(step, rates, seed):
    """Recordings of robots with these rates, every row measured with an error."""
    rng = np.random.default_rng(seed)
    episodes = []
    for i, rate in enumerate(rates):
        u, x = rng.normal(size=(ROWS, 1)), [np.array([[1.0]])]
        for t in range(ROWS - 1):
            x.append(step(x[-1], u[t : t + 1], np.array([[rate]])) + PROCESS * rng.normal(size=(1, 1)))
        measured = np.concatenate(x) + SENSOR * rng.normal(size=(ROWS, 1))
        time = DT * np.arange(ROWS)
        episodes.append(nfpde.Episode(f"{i}", time, measured, np.empty((ROWS, 0)), u, robot=f"{i}"))
    simulator = nfpde.CallableSimulator(step, SPACE, positions=["x"])
    problem = make_problem(simulator, nfpde.Dataset(episodes), 1)
    (unit,) = problem.unit
    return problem, Scatter(np.array([(SENSOR / unit) ** 2]), np.array([[(PROCESS / unit) ** 2]]))


def begin(problem, rates, errors=0.0):
    """Start from these rates and errors of all states, in units of the sensors' noise."""
    n, (unit,) = len(problem.windows), problem.unit
    z = SPACE.to_unconstrained(np.reshape(rates, (-1, 1)))
    spread = np.full(1, SENSOR / unit)
    return Linear(z, spread, np.ones(n), np.broadcast_to(errors * spread, (n, 1)).copy())


@pytest.mark.parametrize("errors", [0.0, 3.0])
def test_cost_is_the_likelihood_with_the_errors_integrated_out(errors):
    """Of a linear system it is the dense Gaussian's, wherever it is linearised."""
    rates = [1.0, -2.0]
    problem, scatter = recorded(decaying, rates, 0)
    linear = begin(problem, [1.3, -1.6], errors)
    at = Linearised.at(problem, linear, scatter, Chains.of(problem.linked))
    found = at.costs(at.places(linear))
    # residual t is .9 e_t - e_(t+1) + w_t
    b = np.zeros((ROWS - 1, ROWS))
    b[np.arange(ROWS - 1), np.arange(ROWS - 1)], b[np.arange(ROWS - 1), np.arange(1, ROWS)] = 0.9, -1.0
    covariance = SENSOR**2 * b @ b.T + PROCESS**2 * np.eye(ROWS - 1)
    expected = []
    for g, z in enumerate(linear.best):
        r = problem.residuals(SPACE.to_physical(linear.best), [0, 1])[g].ravel() * problem.unit
        prior = float((log_expit(z) + log_expit(-z)).sum())
        # in the units of the cost, and without the constant that it leaves out
        log_det = np.linalg.slogdet(covariance / problem.unit[0] ** 2)[1]
        expected.append(r @ np.linalg.solve(covariance, r) + log_det - 2 * prior)
    # tails of a million degrees of freedom stand for a Gaussian
    np.testing.assert_allclose(found, expected, rtol=1e-3)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_it_ends_at_the_joint_least_squares_fit(seed):
    """From far away: parameters and states of a bent system equal scipy's, which fits both at once."""
    rates = [1.5, 0.8]
    problem, scatter = recorded(swinging, rates, seed)
    away = begin(problem, [0.3, 2.5], 2.0)
    found, _, still = settle(problem, away, scatter, Chains.of(problem.linked), 8)
    assert still
    for g in range(2):
        own = problem.members[g]
        measured = np.append(problem.windows.state[own, 0, 0], problem.windows.state[own[-1], 1, 0])
        u = problem.windows.ctrl[own, 0, 0]

        def parts(p, measured=measured, u=u):
            states, rate = p[:-1], SPACE.to_physical(p[-1:])[0]
            process = states[1:] - swinging(states[:-1], u, rate)
            z = p[-1]
            prior = np.sqrt(-2 * (log_expit(z) + log_expit(-z)))
            return np.concatenate([(states - measured) / SENSOR, process / PROCESS, [prior]])

        joint = least_squares(
            parts, np.append(measured, SPACE.to_unconstrained(np.array(rates[g : g + 1]))), xtol=1e-12
        )
        states, z = joint.x[:-1], joint.x[-1]
        spread = np.sqrt(np.diag(np.linalg.inv(joint.jac.T @ joint.jac)))
        # the last turn may move the parameters by .3 of a standard deviation, each turn by less than the one before;
        # the errors follow them
        assert abs(found.best[g, 0] - z) < 0.1 * spread[-1]
        errors = found.errors[own, 0] * problem.unit[0]
        np.testing.assert_allclose(measured[:-1] - errors, states[:-1], atol=0.1 * SENSOR)


def test_no_robot_ends_less_likely_than_it_began():
    """Where a step of an impact throws the turns about, the likeliest is kept: most gain ten nats by it."""

    def bouncing(x, u, xi):
        return np.where(x > 0.5, 0.2 * x, x) + DT * xi * u

    problem, scatter = recorded(bouncing, np.linspace(-3, 3, 12), 4)
    chains = Chains.of(problem.linked)
    first = begin(problem, np.full(12, 0.1))
    costs = []
    found, there, _ = settle(problem, first, scatter, chains, 8)
    for linear in (first, found):
        at = Linearised.at(problem, linear, scatter, chains)
        costs.append(at.costs(at.places(linear)))
    # what it hands on is linearised at what it hands on, though the robots are of different turns
    np.testing.assert_array_equal(there.costs(there.places(found)), costs[1])
    assert (costs[1] <= costs[0] + TURNS * UNSEEN).all()
    assert (costs[1] < costs[0] - 10).sum() >= 10


def test_only_those_that_gain_take_the_others_place():
    """Parameters, weights and errors of the taken robots, and of no other."""
    problem, _ = recorded(decaying, [1.0, 2.0, 3.0], 5)
    one, two = begin(problem, [1.0, 2.0, 3.0]), begin(problem, [4.0, 5.0, 6.0], 1.0)
    two.weights[:] = 0.5
    mixed = one.where(np.array([False, True, False]), two, problem)
    np.testing.assert_allclose(SPACE.to_physical(mixed.best).ravel(), [1.0, 5.0, 3.0])
    taken = np.isin(np.arange(len(problem.windows)), problem.members[1])
    np.testing.assert_array_equal(mixed.weights, np.where(taken, 0.5, 1.0))
    np.testing.assert_array_equal(mixed.errors[:, 0], np.where(taken, two.errors[:, 0], 0.0))
    np.testing.assert_array_equal(one.weights, 1.0)
    np.testing.assert_array_equal(one.errors, 0.0)


def test_robots_that_go_around_between_contacts_come_to_rest():
    """Hoppers with noise of .1 %: no robot is farther from the truth than chance takes it.

    With the noise learned anew in every round, two of these ten ended 5 to 7 standard deviations off: they went around
    for ever, and stayed where the last round had left them.
    """
    hopper = robot("hopper")
    dataset, truth = collect(hopper, "mixture", episodes=10, steps=150, seed=1)
    noisy, _ = with_noise(hopper.model, dataset, 0.001, 1)
    problem = make_problem(nfpde.MujocoSimulator(hopper.path, hopper.space), noisy, 1)
    estimator = TrajectoryEstimator(problem, nfpde.TrajectoryConfig(), 2)
    while not estimator.done:
        estimator.step()
    steps = problem.simulator.simulated_steps
    found = estimator.posteriors()
    assert problem.simulator.simulated_steps == steps  # all is known since it settled
    errors = np.array([p.means[0] for p in found]) - hopper.space.to_unconstrained(truth.xi)
    stds = np.sqrt([np.diag(p.covariances[0]) for p in found])
    # the largest of 60 standard normals passes 4.5 once in 2,500 times
    assert np.abs(errors / stds).max() < 4.5
