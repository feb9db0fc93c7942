"""Levenberg-Marquardt of many candidates: it ends at a minimum, and spends no simulation once it is there."""

import numpy as np
import pytest

import nfpde
from nfpde.estimation.trajectory import make_problem
from nfpde.estimation.trajectory.levenberg import UNSEEN, Candidates, improve, linearise, start
from nfpde.estimation.trajectory.noise import Noise, Scatter

DT, ROWS = 0.1, 41
SPACE = nfpde.ParameterSpace([nfpde.Parameter("gain", low=-10.0, high=10.0)])


def linear_step(x, u, xi):
    return x + DT * xi * u


def bent_step(x, u, xi):
    return x + DT * np.sinh(xi) * u


def problem_of(step, scale):
    """One recording at a gain of 2 with errors on its ends, and noise of `scale` to weigh them with."""
    rng = np.random.default_rng(0)
    u = rng.normal(size=(ROWS, 1))
    x = np.zeros((ROWS, 1))
    for t in range(ROWS - 1):
        x[t + 1] = step(x[t][None], u[t][None], np.array([[2.0]]))[0]
    x += 1e-3 * rng.normal(size=x.shape)
    one = nfpde.Episode("one", DT * np.arange(ROWS), x, np.empty((ROWS, 0)), u)
    problem = make_problem(nfpde.CallableSimulator(step, SPACE, positions=["x"]), nfpde.Dataset([one]), 1)
    return problem, Noise.alike(Scatter(np.zeros(0), scale**2 * np.eye(1)), problem.members)


def candidates(problem, noise, xi) -> Candidates:
    z = SPACE.to_unconstrained(np.array(xi, float)[:, None])
    return start(problem, z, np.zeros(len(z), np.intp), noise)


def promised(problem, noise, c: Candidates, k=0):
    """Cost that a full step from candidate k would still gain, by the linear model."""
    (gradient,) = linearise(problem, c, noise, np.array([k]))
    return float(gradient @ np.linalg.solve(c.information[k], gradient))


def steps_of(problem, noise, c: Candidates):
    before = problem.simulator.simulated_steps
    improve(problem, c, noise, 30)
    return problem.simulator.simulated_steps - before


def test_a_step_that_gains_what_it_promised_is_the_last():
    """Where the model is linear and the noise is Gaussian one Jacobian and three trials find the minimum."""
    problem, noise = problem_of(linear_step, 0.5)
    c = candidates(problem, noise, [1.9])
    assert promised(problem, noise, c) > 10 * UNSEEN, "there is something to gain"
    assert steps_of(problem, noise, c) == (1 + 3) * (ROWS - 1)
    assert promised(problem, noise, c) < UNSEEN


@pytest.mark.parametrize("begin", [-6.0, 0.5, 5.0])
def test_it_goes_on_where_the_model_is_bent(begin):
    """Far from the minimum a step gains something else than it promised; in the end nothing is left to gain."""
    problem, noise = problem_of(bent_step, 1e-3)
    c = candidates(problem, noise, [begin])
    assert steps_of(problem, noise, c) > (1 + 3) * (ROWS - 1)
    assert promised(problem, noise, c) < 2 * UNSEEN


def test_a_double_is_not_polished():
    """A candidate within a standard deviation of one that has converged costs nothing more; farther away it goes on."""
    problem, noise = problem_of(linear_step, 1e-2)
    c = candidates(problem, noise, [1.5, 1.5])
    improve(problem, c, noise, 30)
    best = int(c.cost.argmin())
    linearise(problem, c, noise, np.array([best]))
    width = 1 / np.sqrt(c.information[best, 0, 0])

    def beside(apart):
        pair = start(problem, c.z[[best, best]] + [[0.0], [apart * width]], np.zeros(2, np.intp), noise)
        pair.information[0], pair.done[0] = c.information[best], True
        return pair

    near, far = beside(0.5), beside(5.0)
    assert steps_of(problem, noise, near) == 0
    assert near.cost[1] == np.inf
    assert steps_of(problem, noise, far) > 0
    assert abs(far.z[1, 0] - far.z[0, 0]) < width
