"""The benchmark of the estimators: noise, bounds, choice of temperature, calibration, going on, and what it says."""

import mujoco
import numpy as np
import pytest
import torch
from scipy.stats import binom, norm

from nfpde.bench.estimation import bending, bound, ranks, stages, temperature
from nfpde.benchmarks import collect, record, robot, sensing
from nfpde.errors import BadInput
from nfpde.estimation import fit
from nfpde.sim import MujocoSimulator, StateSpace

torch.set_num_threads(1)

PENDULUM, HUMANOID = robot("pendulum"), robot("humanoid")


@pytest.fixture(scope="module")
def swings():
    return collect(PENDULUM, "gaussian", episodes=3, steps=60, seed=3)


@pytest.fixture(scope="module")
def pendulum():
    return MujocoSimulator(PENDULUM.path, PENDULUM.space)


def test_recordings_of_given_robots():
    """Episodes with one label have one robot, and move as its parameters say."""
    xi = PENDULUM.space.uniform(2, np.random.default_rng(0)).repeat(2, 0)
    data = record(PENDULUM, xi, steps=20, rng=np.random.default_rng(1), labels=["a", "a", "b", "b"])
    assert data.robots == ["a", "b"]
    simulator = MujocoSimulator(PENDULUM.path, PENDULUM.space)
    windows = data.transitions()
    losses = simulator.losses(xi, windows, np.ones(2))
    own = losses[windows.episode, np.arange(len(windows))]
    assert own.max() < 1e-20  # the recording without the warm start
    assert losses[3, windows.episode < 2].mean() > 1e-8
    with pytest.raises(BadInput, match=r"1 labels for 4 parameter vectors; give one for each"):
        record(PENDULUM, xi, steps=2, rng=np.random.default_rng(0), labels=["a"])


@pytest.mark.parametrize("body", [PENDULUM, HUMANOID], ids=["hinge", "free joint"])
def test_noise_is_a_share_of_what_channels_move(body):
    """White, of the wanted size on every channel, and a rotation stays a rotation."""
    clean, _ = collect(body, "gaussian", episodes=10, steps=150, seed=0)
    noisy, sigma = sensing.with_noise(body.model, clean, 0.02, seed=5)
    states = StateSpace.of_model(body.model)
    a, b = (np.concatenate([np.hstack([e.qpos, e.qvel]) for e in d]) for d in (clean, noisy))
    added = states.difference(b, a) / sigma
    n = len(added)
    # the standard deviation of n draws is known to 1 / sqrt(2 n); five of those over all channels
    np.testing.assert_allclose(added.std(0), 1.0, atol=5 / np.sqrt(2 * n))
    # correlation of neighbouring rows: 1 / sqrt(n) each
    assert np.abs((added[1:] * added[:-1]).mean(0)).max() < 5 / np.sqrt(n)
    plain = [i for i, name in enumerate(states.channels) if name.startswith("qvel")]
    np.testing.assert_allclose(sigma[plain], 0.02 * a[:, states.nq :].std(0), rtol=1e-12)
    for column, _ in states.quaternions:
        np.testing.assert_allclose(np.linalg.norm(b[:, column : column + 4], axis=1), 1.0, rtol=1e-12)


def test_transitions_apart_share_no_error(swings):
    """Cut into transitions, the end of one and the start of the next are the same state with different errors."""
    pieces = sensing.apart(swings[0])
    assert pieces.robots == ["0", "1", "2"]
    np.testing.assert_array_equal(pieces.transitions().state, swings[0].transitions().state)
    noisy, sigma = sensing.with_noise(PENDULUM.model, pieces, 0.1, seed=0)
    added = (noisy.transitions().state - pieces.transitions().state) / sigma
    ends, starts = added[:-1, 1].ravel(), added[1:, 0].ravel()
    # a correlation of n numbers is known to 1 / sqrt(n); shared errors would make it 1
    assert abs(np.corrcoef(ends, starts)[0, 1]) < 5 / np.sqrt(len(ends))


def test_no_noise_leaves_the_recordings_alone(swings):
    """A share of zero gives back the data set itself."""
    noisy, sigma = sensing.with_noise(PENDULUM.model, swings[0], 0.0, seed=0)
    assert noisy is swings[0]
    assert not sigma.any()


def test_velocities_that_no_sensor_measured(swings):
    """Differenced ones say so and are central; filtered ones lag behind, forget at the rate of a step, and do not."""
    taken = sensing.differenced(swings[0])
    assert taken.metadata.conventions["velocities"] == "differences of the positions"
    for before, after in zip(swings[0], taken, strict=True):
        assert after.qvel[1:-1] == pytest.approx((before.qpos[2:] - before.qpos[:-2]) / (2 * taken.control_dt))
    for before, after in zip(swings[0], sensing.filtered(swings[0]), strict=True):
        rates, expected = np.diff(before.qpos, axis=0) / taken.control_dt, np.zeros_like(before.qvel)
        for row, rate in enumerate(rates, 1):
            expected[row] = rate + np.exp(-1.0) * (expected[row - 1] - rate)
        assert after.qvel == pytest.approx(expected)
    assert sensing.filtered(swings[0]).metadata == swings[0].metadata


@pytest.mark.parametrize("joint", [True, False])
def test_information_is_generalised_least_squares(joint):
    """The elimination equals the dense formula with the covariance of e' - F e over a whole episode."""
    rng = np.random.default_rng(0)
    steps, channels, parameters = 6, 3, 2
    f, j = rng.normal(size=(steps, channels, channels)), rng.normal(size=(steps, channels, parameters))
    sigma = np.array([0.1, 1.0, 3.0])
    mixing = np.zeros((steps * channels, (steps + 1) * channels))
    for t in range(steps):
        rows = slice(t * channels, (t + 1) * channels)
        mixing[rows, rows] = -f[t]
        mixing[rows, (t + 1) * channels : (t + 2) * channels] = np.eye(channels)
    covariance = mixing @ np.kron(np.eye(steps + 1), np.diag(sigma**2)) @ mixing.T
    if not joint:
        covariance = covariance * np.kron(np.eye(steps), np.ones((channels, channels)))
    design = j.reshape(-1, parameters)
    expected = design.T @ np.linalg.solve(covariance, design)
    np.testing.assert_allclose(bound.information(j, f, sigma, joint=joint), expected, rtol=1e-9)
    process = np.diag([0.5, 0.0, 2.0])
    expected = design.T @ np.linalg.solve(covariance + np.kron(np.eye(steps), process), design)
    np.testing.assert_allclose(bound.information(j, f, sigma, joint=joint, process=process), expected, rtol=1e-9)


def test_derivatives_of_the_motion(swings, pendulum):
    """By the state: MuJoCo's own derivatives, chained over the physics steps. By parameters: a finite step."""
    data, truth = swings
    windows = data.transitions()[np.arange(0, 180, 20)]
    by_state = bound.state_slopes(pendulum, windows, truth.xi, np.ones(2))
    model = pendulum.model
    state = mujoco.MjData(model)
    for n, found in enumerate(by_state):
        fields = pendulum.writer.rows(truth.xi[windows.episode[n]][None])
        for name, values in fields.items():
            getattr(model, name)[:] = values[0].reshape(getattr(model, name).shape)
        mujoco.mj_resetData(model, state)
        state.qpos[:], state.qvel[:], state.ctrl[:] = windows.start[n, :1], windows.start[n, 1:], windows.ctrl[n, 0]
        expected = np.eye(2)
        for _ in range(pendulum.substeps(data.control_dt)):
            a = np.zeros((2, 2))
            mujoco.mjd_transitionFD(model, state, 1e-6, True, a, None, None, None)
            expected = a @ expected
            mujoco.mj_step(model, state)
        # one-sided differences of size 1e-4 of a curved motion
        np.testing.assert_allclose(found, expected, atol=1e-3)
    by_parameter = bound.parameter_slopes(pendulum, windows, truth.xi)
    step = 0.01 * PENDULUM.space.width
    moved = pendulum.rollout(truth.xi + step, windows, windows.episode, np.arange(len(windows)))[:, 0]
    there = pendulum.rollout(truth.xi, windows, windows.episode, np.arange(len(windows)))[:, 0]
    # a step of a hundredth of the box bends by some hundredths
    np.testing.assert_allclose(0.01 * by_parameter.sum(2), moved - there, rtol=0.05, atol=1e-6)


def test_bounds_of_a_pendulum(swings, pendulum):
    """Whole episodes tell more than their transitions alone, less noise tells more, and never less than the prior."""
    data, truth = swings
    small, large = (bound.information_bound(pendulum, data, truth, s * np.array([0.1, 0.5])) for s in (0.001, 0.1))
    one_step, whole = [], []
    for found in (small, large):
        assert found.one_step is not None
        assert found.whole is not None
        one_step.append(found.one_step)
        whole.append(found.whole)
        assert (found.whole <= found.one_step * (1 + 1e-9)).all()
        assert (found.one_step <= 1 / np.sqrt(12) + 1e-12).all()
    assert (one_step[0] < one_step[1]).all()
    assert (whole[0] < whole[1]).all()
    none = bound.information_bound(pendulum, data, truth, np.zeros(2))
    assert none.one_step is None
    np.testing.assert_array_equal(none.sensitivity, small.sensitivity)


def test_a_smooth_motion_is_linear_within_small_noise(swings, pendulum):
    """Without contacts a linear prediction errs by the square of the noise, and the bound stays what it is."""
    data, truth = swings
    sigma = 0.1 * np.array([0.1, 0.5])
    small, large = (bending.bending(pendulum, data, truth, s * sigma, 0) for s in (1.0, 10.0))
    # the same directions, ten times as long: the second order grows a hundredfold, the noise tenfold; the third
    # order and the differences that slopes are made of are hundredths of it
    assert large.error == pytest.approx(10 * small.error, rel=0.1)
    assert large.often == 0
    whole = bound.information_bound(pendulum, data, truth, sigma).whole
    assert whole is not None
    np.testing.assert_allclose(small.whole, whole, rtol=1e-3)


def test_contacts_bend_the_motion(swings, pendulum):
    """Feet on the floor make a motion far less linear within its noise than a pendulum's, and the bound wider."""
    data, truth = swings
    smooth = bending.bending(pendulum, data, truth, 0.01 * sensing.channel_spread(pendulum.states, data), 0)
    runner = robot("half_cheetah")
    data, truth = collect(runner, "gaussian", episodes=2, steps=40, seed=0)
    simulator = MujocoSimulator(runner.path, runner.space)
    sigma = 0.01 * sensing.channel_spread(simulator.states, data)
    found = bending.bending(simulator, data, truth, sigma, 0)
    assert found.error > 10 * smooth.error
    whole = bound.information_bound(simulator, data, truth, sigma).whole
    assert whole is not None
    assert (found.whole >= whole * (1 - 1e-9)).all(), "more noise, less information"


def test_friction_is_unknown_where_nothing_slides():
    """The fit of the transitions that friction does not move finds it undetermined, and the torso's mass exactly."""
    body = robot("walker2d")
    data, truth = collect(body, "gaussian", episodes=2, steps=30, seed=1)
    simulator = MujocoSimulator(body.path, body.space)
    still = bound.unmoved(simulator, data, truth, parameter=6)
    sliding = bound.information_bound(simulator, data, truth, np.zeros(18))
    assert 0 < len(still) < len(data.transitions())
    np.testing.assert_allclose(
        [1 - len(still.subset([i for i, e in enumerate(still) if e.robot == name])) / (len(e) - 1) for name, e in
         zip(data.names, data, strict=True)],
        sliding.felt[:, 6],
    )  # fmt: skip
    result = fit(simulator, still, method="trajectory", quiet=True)
    for found in result.info["robots"]:
        friction, torso = (found["parameters"][body.space.names[i]] for i in (6, 0))
        assert friction["cramer_rao"] is None
        assert friction["known"] < 0.1  # the prior's width, but for sampling
        assert torso["known"] > 0.99


def test_marginal_likelihood_of_one_vector():
    """With one parameter vector it is that of a Gaussian at its maximum-likelihood variance."""
    losses, channels = np.random.default_rng(0).exponential(size=(1, 50)), 4
    variance = losses.mean() / channels
    expected = -0.5 * channels * (np.log(2 * np.pi * variance) + 1)
    # the search stops within 1e-5 of the best log beta, where the curve is flat
    assert temperature.marginal_likelihood(losses, channels) == pytest.approx(expected, abs=1e-6)


def test_marginal_likelihood_prefers_what_explains_the_data():
    """Of two clouds of parameter vectors the one around the truth scores higher, whatever the units of the losses."""
    rng = np.random.default_rng(1)
    data = rng.normal(size=(3, 40))
    close, far = (((data[:, None] - (shift + rng.normal(size=(3, 200)))[:, :, None]) ** 2).sum(0) for shift in (0, 3))
    scores = [temperature.marginal_likelihood(losses, 3) for losses in (close, far)]
    assert scores[0] > scores[1]
    scaled = temperature.marginal_likelihood(100 * close, 3)
    assert scaled == pytest.approx(scores[0] - 1.5 * np.log(100), abs=1e-4)


def test_ranks_of_exact_posteriors_are_calibrated():
    """A conjugate Gaussian covers as it should, half its width does not; the error of the pooled figure is right."""
    rng = np.random.default_rng(0)
    problems, samples = 400, 199
    true = rng.normal(size=(problems, 2))
    data = true + rng.normal(size=true.shape)
    found = {}
    for width in (1.0, 0.5):
        draws = data[:, None] / 2 + width * np.sqrt(0.5) * rng.normal(size=(problems, samples, 2))
        found[width] = np.array([ranks.rank_of(t, d) for t, d in zip(true, draws, strict=True)])
    for share in (0.5, 0.9):
        good = ranks.coverage(found[1.0], samples, share)
        # four standard errors
        assert abs(good["pooled"] - share) < 4 * np.sqrt(share * (1 - share) / (2 * problems))
        narrow = 2 * norm.cdf(0.5 * norm.ppf(0.5 + share / 2)) - 1
        assert abs(ranks.coverage(found[0.5], samples, share)["pooled"] - narrow) < 0.08
        assert good["error"] == pytest.approx(binom.std(problems, share) / problems)
        # the two parameters are independent here: half the variance of one
        assert good["pooled_error"] == pytest.approx(good["error"] / np.sqrt(2), rel=0.25)


def test_rank_histogram_counts_every_rank_once(tmp_path):
    """All ranks there are, once each: flat bins, and exact coverage."""
    samples = 99
    all_ranks = np.arange(samples + 1)[:, None]
    assert ranks.histogram(all_ranks, samples) == [[10] * 10]
    assert ranks.coverage(all_ranks, samples, 0.5)["pooled"] == 0.5
    assert ranks.coverage(all_ranks, samples, 0.9)["pooled"] == 0.9
    assert ranks.draw_ranks(all_ranks, samples, ["mass"], "all", tmp_path / "ranks.png").stat().st_size > 1000


def test_stages_go_on_where_they_stopped(tmp_path):
    """A finished stage is not computed again, one with other settings is; the file is there when all is done."""
    computed = []

    def compute(name):
        computed.append(name)
        return {"of": name}

    def open_stages(minutes=None, seed=0):
        return stages.Stages(tmp_path, "cell", {"seed": seed}, stages.Budget.of(minutes))

    first = open_stages()
    first("a", lambda: compute("a"), {"size": 1})
    assert not first.path.is_file()
    first("no longer asked for", lambda: compute("x"))
    over = open_stages(minutes=1e-9)
    assert over("a", lambda: compute("again"), {"size": 1}) == {"of": "a"}
    with pytest.raises(stages.OutOfTime):
        over("b", lambda: compute("late"))
    with pytest.raises(stages.OutOfTime):
        over("a", lambda: compute("late"), {"size": 2})
    again = open_stages()
    assert again("a", lambda: compute("larger"), {"size": 2}) == {"of": "larger"}
    assert computed == ["a", "x", "larger"]
    assert stages.results(again.finish()) == {"a": {"of": "larger"}}
    assert open_stages().finished() is not None
    assert open_stages(seed=1).finished() is None
    assert [p.name for p in tmp_path.iterdir()] == ["cell.json"]
    with pytest.raises(BadInput, match="budget is 0 minutes; give a positive number"):
        stages.Budget.of(0)


def test_stages_of_older_code(tmp_path, monkeypatch):
    """An unfinished cell starts afresh with new code, a finished one stays; `renew` does one stage again."""
    computed = []

    def open_stages(renew=None):
        return stages.Stages(tmp_path, "cell", {}, stages.Budget.of(None), renew=renew)

    def work(cell):
        for name in ("slow", "quick"):
            cell(name, lambda name=name: computed.append(name))

    monkeypatch.setattr(stages, "provenance", lambda: {"commit": "old", "uncommitted": []})
    open_stages()("slow", lambda: computed.append("slow"))
    monkeypatch.setattr(stages, "provenance", lambda: {"commit": "new", "uncommitted": []})
    cell_now = open_stages()
    work(cell_now)
    cell_now.finish()
    assert computed == ["slow", "slow", "quick"]
    monkeypatch.setattr(stages, "provenance", lambda: {"commit": "newest", "uncommitted": []})
    assert open_stages().finished() is not None
    renewed = open_stages(renew="quick")
    assert renewed.finished() is None
    work(renewed)
    assert computed == ["slow", "slow", "quick", "quick"]
    content = renewed.finish()
    assert [stages.code_of(content["stages"][name]) for name in ("slow", "quick")] == ["new", "newest"]
    assert open_stages(renew="quick").finished() is not None


def test_provenance_names_the_commit():
    """Commit and versions; outside of a checkout the commit is null."""
    found = stages.provenance()
    assert found["commit"] is None or len(found["commit"]) == 40
    assert found["versions"]["mujoco"] == mujoco.__version__
