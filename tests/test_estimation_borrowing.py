"""Starts borrowed from other robots: who tries them, that they free robots that are stuck, and what they cost."""

import numpy as np
from scipy.stats import binom

import nfpde
from nfpde.estimation.trajectory import TrajectoryEstimator, make_problem
from nfpde.estimation.trajectory import estimator as module
from nfpde.estimation.trajectory.borrowing import CHANCE, anything_new, borrowed_from, standing_out
from nfpde.estimation.trajectory.levenberg import Candidates, restart, start

DT = 0.1
SPACE = nfpde.ParameterSpace([nfpde.Parameter("shape", low=-10.0, high=10.0)])
TRAP = -5.0


def two_hills(x, u, xi):
    """The input's gain is a high hill at 5 and a low one at -5: whoever is on the low one finds it worse all around."""
    gain = np.exp(-0.5 * (xi - 5.0) ** 2) + 0.3 * np.exp(-0.5 * (xi - TRAP) ** 2)
    return x + DT * gain * u


def episode(name, xi, rng, rows=40):
    u = rng.normal(size=(rows, 1))
    x = np.zeros((rows, 1))
    for t in range(rows - 1):
        x[t + 1] = two_hills(x[t][None], u[t][None], np.array([[xi]]))[0]
    return nfpde.Episode(name, DT * np.arange(rows), x, np.empty((rows, 0)), u)


def estimator(robots=4):
    rng = np.random.default_rng(0)
    dataset = nfpde.Dataset([episode(f"{i}", 5.3 + 0.1 * i, rng) for i in range(robots)])
    simulator = nfpde.CallableSimulator(two_hills, SPACE, positions=["x"])
    return TrajectoryEstimator(make_problem(simulator, dataset, 1), nfpde.TrajectoryConfig(starts=8), 0)


def trap(fitted, robot=0):
    """Put all of a robot's candidates on the low hill."""
    c = fitted.candidates
    c.z[c.robot == robot] = SPACE.to_unconstrained(np.array([TRAP]))
    restart(fitted.problem, c, fitted.noise)


def best(fitted):
    c = fitted.candidates
    return SPACE.to_physical(c.z[c.best(fitted.robots)])[:, 0]


def gain(xi):
    return two_hills(np.zeros((1, 1)), np.ones((1, 1)), np.array([[xi]]))[0, 0] / DT


def test_the_low_hill_holds_whoever_is_alone_there():
    """Without others to borrow from, a robot on the low hill stays: the trap of these tests is one."""
    fitted = estimator(robots=1)
    fitted.step()
    trap(fitted)
    fitted.step()
    assert abs(best(fitted)[0] - TRAP) < 0.5


def test_a_robot_that_is_stuck_gets_out_in_the_first_round_of_borrowing():
    """All robots borrow once, and the one in a local minimum ends where its recording is explained."""
    fitted = estimator()
    fitted.step()
    trap(fitted)
    fitted.step()
    assert abs(gain(best(fitted)[0]) - gain(5.3)) < 1e-6
    assert fitted.borrowing_pays, "a place was found that was not known: the next round borrows for all"


def test_a_robot_that_stands_out_borrows_again():
    """Where borrowing had found nothing for anybody, a robot that is explained worse than the others still gets out."""
    fitted = estimator()
    fitted.step()
    fitted.step()
    assert not fitted.borrowing_pays
    trap(fitted)
    fitted.step()
    assert abs(gain(best(fitted)[0]) - gain(5.3)) < 1e-6


def test_borrowing_ends_where_it_finds_nothing(monkeypatch):
    """Robots that all stand where their recordings are explained borrow two places each, once."""
    started = []
    monkeypatch.setattr(module, "start", lambda p, z, robot, noise: started.append(len(z)) or start(p, z, robot, noise))
    fitted = estimator()
    while not fitted.done:
        fitted.step()
    assert fitted.iteration > 2
    assert started == [8 * 4, 2 * 4], "the starts, and one round of borrowing"


def test_what_decides_about_borrowing_is_saved():
    """A fit that goes on from a checkpoint borrows as one that was never stopped."""
    fitted, again = estimator(), estimator()
    fitted.step()
    fitted.step()
    again.restore(*fitted.state())
    assert again.borrowing_pays is fitted.borrowing_pays is False


def test_robots_alike_stand_out_as_seldom_as_promised():
    """Of eight robots with costs of the same distribution one stands out in at most a hundredth of the cases."""
    rng = np.random.default_rng(1)
    cases = sum(len(standing_out(list(rng.chisquare(6, size=(8, 60))), 6)) > 0 for _ in range(500))
    # a test of this level is above this number once in a thousand
    assert cases <= binom.ppf(0.999, 500, CHANCE)


def test_a_robot_explained_worse_stands_out():
    """Twice the others' cost is seen; a window that diverged too; so is one of two robots."""
    rng = np.random.default_rng(2)
    costs = list(rng.chisquare(6, size=(8, 60)))
    costs[3] = 2 * costs[3]
    assert standing_out(costs, 6).tolist() == [3]
    costs[5] = costs[5].copy()
    costs[5][7] = np.nan
    assert standing_out(costs, 6).tolist() == [3, 5]
    assert standing_out([costs[0], 4 * costs[1]], 6).tolist() == [1]


def test_what_no_statistic_sees_does_not_stand_out():
    """Where the simulation explains all to rounding errors, differences between robots mean nothing."""
    rng = np.random.default_rng(3)
    costs = [1e-9 * (i + 1) * rng.chisquare(6, size=60) for i in range(8)]
    assert not len(standing_out(costs, 6))


def test_turns_go_around_the_robots():
    """Three turns of seven robots try every other one once and never themselves; of two there is one other."""
    tried = [borrowed_from(7, np.arange(7), turn) for turn in (1, 2, 3)]
    pairs = [(int(a), int(b)) for robot, other in tried for a, b in zip(robot, other, strict=True)]
    assert sorted(pairs) == [(a, b) for a in range(7) for b in range(7) if a != b]
    robot, other = borrowed_from(2, np.array([1]), 1)
    assert (robot.tolist(), other.tolist()) == ([1], [0])


def places(z, cost):
    """Candidates of one robot at z (K,), known to one each."""
    k = len(z)
    one = np.ones((k, 1, 1))
    done = np.zeros(k, bool)
    z, cost, damping = np.array(z)[:, None], np.array(cost), np.full(k, 1e-2)
    return Candidates(np.zeros(k, np.intp), z, cost, [np.zeros((1, 1))] * k, one, one, damping, done)


def test_new_is_what_is_elsewhere_and_has_weight():
    """A known place found again is nothing new, nor is one that explains far worse than what was known."""
    assert not anything_new(places([0.0, 0.5], [1.0, 1.0]), 1)
    assert not anything_new(places([0.0, 5.0], [1.0, 100.0]), 1)
    assert anything_new(places([0.0, 5.0], [1.0, 2.0]), 1)
    assert anything_new(places([0.0, 5.0], [100.0, 1.0]), 1)
