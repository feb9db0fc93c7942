"""Algorithm 1 on losses with a closed form: what it finds, its surrogate, and going on from a saved state."""

import copy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from nfpde.checkpoint import load_state, save_state
from nfpde.errors import BadInput
from nfpde.estimation import NfpdeConfig, NfpdeTrainer
from nfpde.estimation.ascent import TRUST, divergence, responsibility, surrogate
from nfpde.estimation.nfpde import as_tensor
from nfpde.ot import emd
from nfpde.parameters import Parameter, ParameterSpace

SPACE = ParameterSpace([Parameter("a", low=-1.0, high=3.0), Parameter("b", low=0.0, high=2.0)])
MODES = np.array([[0.0, 0.5], [2.0, 1.5]])
ROBOTS = MODES[np.arange(100) % 2] + 0.05 * np.random.default_rng(0).normal(size=(100, 2))
"""A hundred robots of two kinds, one transition each."""

LEARNING = NfpdeConfig(
    iterations=30,
    samples=300,
    transitions=50,
    gradient_steps=8,
    learning_rate=5e-3,
    transforms=3,
    hidden=16,
    clip=0.5,
    least_effective=5.0,
)
TINY = NfpdeConfig(iterations=6, samples=20, transitions=7, gradient_steps=2, transforms=2, hidden=8)


def losses(xi, batch):
    """Transitions that show the parameters themselves: the squared distance to the robot's."""
    return ((xi[:, None] - ROBOTS[batch]) ** 2).sum(2)


def trainer(candidate: Any = "softmax", config=TINY, seed=0, loss=losses):
    return NfpdeTrainer(loss, len(ROBOTS), 2, SPACE, candidate, config, seed)


def run(candidate, config, seed, loss=losses):
    made = trainer(candidate, config, seed, loss)
    for _ in range(config.iterations):
        made.step()
    return made


def samples(made):
    return SPACE.to_physical(made.flow.sample(500, torch.Generator().manual_seed(9)).numpy())


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    """As `nfpde.fit` has it."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def fitted(one_thread):
    """Samples of the flow after all iterations, for both candidates and three seeds."""
    return {(c, s): samples(run(c, LEARNING, s)) for c in ("softmax", "cai") for s in range(3)}


@pytest.mark.parametrize("seed", range(3))
def test_softmax_finds_the_population(fitted, seed):
    """Two kinds of robots are found from single transitions: the exact distance to them falls far below half.

    What is left at a few hundredths of the box is the width that the temperature's floor keeps: with 300 samples and
    5 effective ones a kind of robot is not told apart from its surroundings of a sixtieth of the samples.
    """
    before = emd(samples(trainer(config=LEARNING, seed=seed)), ROBOTS).cost
    after = emd(fitted["softmax", seed], ROBOTS).cost
    assert after < 0.3 * before
    # both kinds, each with half of the robots: 100 robots vary by 5 %, three times that is left for the fit
    near = np.linalg.norm(fitted["softmax", seed][:, None] - MODES, axis=2) < 0.5
    np.testing.assert_allclose(near.mean(0), 0.5, atol=0.15)


@pytest.mark.parametrize("seed", range(3))
def test_cai_ends_at_a_point(fitted, seed):
    """The mean of minus the losses is largest at one point, here the robots' mean, which is no robot at all."""
    xi, mean = fitted["cai", seed], ROBOTS.mean(0)
    # the mean loss at xi is |xi - mean|^2 + var(robots): its excess over the least possible, beside that of the box
    excess = ((xi - mean) ** 2).sum(1).mean()
    assert excess < 0.1 * (SPACE.width**2).sum() / 12
    assert (xi.std(0) < 0.5 * fitted["softmax", seed].std(0)).all()
    assert emd(xi, ROBOTS).cost > 3 * emd(fitted["softmax", seed], ROBOTS).cost


class OnGpu:
    """Losses in a GPU's memory, which torch reads only where it has CUDA itself."""

    def __dlpack_device__(self):
        return 2, 0

    def __dlpack__(self, *args, **kwargs):
        raise AssertionError("Torch not compiled with CUDA enabled")

    def numpy(self):
        return np.array([[1.0, 2.0]])


def test_losses_that_torch_cannot_reach_are_copied(monkeypatch):
    """Warp may have a GPU where torch has none; on the host nothing is copied."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert as_tensor(OnGpu()).tolist() == [[1.0, 2.0]]
    here = np.zeros((2, 3))
    as_tensor(here)[0, 0] = 7.0
    assert here[0, 0] == 7.0


def test_surrogate_by_hand():
    """PPO's: min(r w, clamp(r) w) takes the clamped ratio only where that is the smaller gain."""
    ratio = torch.tensor([0.5, 1.0, 1.1, 2.0, 0.5, 1.0, 1.1, 2.0])
    weight = torch.tensor([3.0, 3.0, 3.0, 3.0, -3.0, -3.0, -3.0, -3.0])
    plain = [1.5, 3.0, 3.3, 6.0, -1.5, -3.0, -3.3, -6.0]
    clipped = [1.5, 3.0, 3.3, 3.6, -2.4, -3.0, -3.3, -6.0]
    for clip, expected in ((0.0, plain), (0.2, clipped)):
        each = [float(surrogate(r[None], w[None], clip)) for r, w in zip(ratio, weight, strict=True)]
        np.testing.assert_allclose(each, expected, rtol=1e-6)
        assert float(surrogate(ratio, weight, clip)) == pytest.approx(sum(expected), rel=1e-6)


def test_surrogate_stops_pulling_beyond_the_range():
    """A sample that already gained or lost more than the range has no gradient; every other has its weight."""
    ratio = torch.tensor([1.5, 0.5, 1.5, 0.5, 1.0], requires_grad=True)
    weight = torch.tensor([2.0, 2.0, -2.0, -2.0, 2.0])
    (gradient,) = torch.autograd.grad(surrogate(ratio, weight, 0.2), ratio)
    np.testing.assert_array_equal(gradient.numpy(), [0.0, 2.0, -2.0, 0.0, 2.0])


def test_what_the_losses_are_asked_for():
    """M vectors inside the box, and a batch of different transitions, over time all of them."""
    asked = []

    def watched(xi, batch):
        asked.append((xi, batch))
        return losses(xi, batch)

    made = trainer(loss=watched)
    for _ in range(200):
        made.step()
    for xi, batch in asked:
        assert xi.shape == (20, 2)
        SPACE.check(xi)
        assert len(set(batch.tolist())) == len(batch) == 7
    # a transition is missed 200 times with probability 0.93^200 = 5e-7
    assert {i for _, batch in asked for i in batch.tolist()} == set(range(100))


def test_a_batch_is_all_there_is_at_most():
    """More transitions asked for than recorded: all of them, each once."""
    sizes = []

    def watched(xi, batch):
        sizes.append(sorted(batch.tolist()))
        return losses(xi, batch)

    NfpdeTrainer(watched, 5, 2, SPACE, "softmax", TINY, 0).step()
    assert sizes == [[0, 1, 2, 3, 4]]


def test_history_and_temperature():
    """A given beta is kept; a found one falls as the samples come to explain the transitions; CAI has none."""
    fixed = run("softmax", replace(TINY, beta=0.25), 0)
    assert [row["beta"] for row in fixed.history] == [0.25] * 6
    found = run("softmax", LEARNING, 0)
    assert [row["iteration"] for row in found.history] == list(range(1, 31))
    assert found.history[-1]["beta"] < 0.1 * found.history[0]["beta"]
    assert found.history[-1]["loss"] < 0.1 * found.history[0]["loss"]
    assert min(row["effective"] for row in found.history) >= LEARNING.least_effective
    assert not {"beta", "effective"} & run("cai", TINY, 0).history[0].keys()


def test_learning_rate_falls_to_a_tenth():
    """Linearly over the iterations, as the settings say."""
    made = trainer()
    rates = []
    for _ in range(6):
        made.step()
        rates.append(made.optimizer.param_groups[0]["lr"] / TINY.learning_rate)
    np.testing.assert_allclose(rates, 1 - 0.9 * np.arange(6) / 6, rtol=1e-12)


def numbers(made):
    """Everything of a trainer that its next iterations depend on or that it reports, seconds left out."""
    tensors, info = made.state()
    rows = [{k: v for k, v in row.items() if k != "seconds"} for row in info["history"]]
    return {k: v.numpy().tobytes() for k, v in tensors.items()}, info | {"history": rows}


@pytest.mark.parametrize("candidate", ["softmax", "cai"])
def test_a_restored_run_goes_on_bit_for_bit(tmp_path, candidate):
    """Through the disk, in a fresh trainer of another seed, after any number of iterations."""
    whole = trainer(candidate)
    saved = []
    for _ in range(6):
        saved.append(whole.state())
        whole.step()
    for done, (tensors, info) in enumerate(saved):
        save_state(tmp_path, tensors, info)
        loaded = load_state(tmp_path)
        assert loaded is not None
        again = trainer(candidate, seed=5)
        again.restore(*loaded)
        assert again.iteration == done
        for _ in range(6 - done):
            again.step()
        assert numbers(again) == numbers(whole)


def test_a_state_can_be_restored_twice():
    """Steps after `restore` leave the state that it came from as it was."""
    first = trainer()
    first.step()
    state = first.state()
    for _ in range(2):
        again = trainer()
        again.restore(*state)
        again.step()
        assert [row["iteration"] for row in again.history] == [1, 2]


def test_seeds():
    """Equal seeds give equal numbers, another seed others; torch's and numpy's own generators play no part."""
    first = run("softmax", TINY, 3)
    torch.manual_seed(1)
    np.random.seed(1)  # noqa: NPY002 (the global state is what must not matter)
    assert numbers(first) == numbers(run("softmax", TINY, 3))
    assert samples(first).tobytes() != samples(run("softmax", TINY, 4)).tobytes()


def test_weights_that_blow_up_are_an_error():
    """A learning rate beyond all reason ends with a message, not with NaN in the distribution."""
    made = trainer(config=replace(TINY, learning_rate=1e200))
    with pytest.raises(BadInput, match=r"no longer finite after iteration 1: the learning rate 1e\+200 is too high"):
        made.step()


@pytest.mark.parametrize("rate", [1e-3, 1.0, 1e4])
@pytest.mark.parametrize("candidate", ["softmax", "cai"])
def test_no_iteration_leaves_its_samples(candidate, rate):
    """The flow diverges from the one that was sampled by no more than the bound, whatever the steps' size."""
    made = trainer(candidate, replace(TINY, learning_rate=rate, samples=200, gradient_steps=20))
    for _ in range(6):
        before = copy.deepcopy(made.flow)
        generator = torch.Generator()
        generator.set_state(made.generator.get_state())
        z = before.sample(200, generator)
        made.step()
        with torch.no_grad():
            assert divergence(made.flow.log_prob(z) - before.log_prob(z)) <= TRUST


def test_divergence_is_that_of_two_gaussians():
    """Mean and width moved: log s + (1 + m^2) / (2 s^2) - 1/2; that of a step to nowhere is infinite."""
    z = torch.randn(100_000, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    for mean, width in ((0.0, 1.0), (0.7, 1.0), (0.0, 0.8), (0.3, 1.5)):
        new = torch.distributions.Normal(mean, width).log_prob(z)
        found = divergence(new - torch.distributions.Normal(0.0, 1.0).log_prob(z))
        exact = np.log(width) + (1 + mean**2) / (2 * width**2) - 0.5
        # five standard errors of a mean of terms that vary by about one
        assert found == pytest.approx(exact, abs=5 / np.sqrt(100_000))
    assert divergence(torch.full((3,), -np.inf)) == np.inf


def test_equal_responsibilities_ask_for_the_samples_as_they_are():
    """The gradient of their mean log likelihood vanishes on average: far less moves it than one that has a size."""
    made = trainer()
    z = made.flow.sample(20_000, torch.Generator().manual_seed(1))
    sizes = []
    for weight in (torch.ones(len(z), dtype=torch.float64), (z[:, 0] > 0).double()):
        log_density = made.flow.log_prob(z)
        gain = responsibility(log_density - log_density.detach(), weight / weight.sum())
        gradient = torch.autograd.grad(gain, list(made.flow.parameters()))
        sizes.append(float(torch.cat([g.flatten() for g in gradient]).norm()))
    assert sizes[0] < 0.05 * sizes[1]


@pytest.mark.parametrize("candidate", ["softmax", "cai"])
def test_losses_that_are_all_alike_leave_the_box(candidate):
    """Through all iterations: nothing was told, and nothing is known."""
    found = run(candidate, LEARNING, 0, lambda xi, batch: np.ones((len(xi), len(batch))))
    # a fit to so many samples misses their width by 4 %, and does so thirty times
    np.testing.assert_allclose(samples(found).std(0), SPACE.width / np.sqrt(12), rtol=0.25)


def test_losses_that_tell_nothing_leave_the_box():
    """Losses by chance: the widths wander with the samples, and on the whole they stay."""
    rng = np.random.default_rng(0)

    def chance(xi, batch):
        return rng.random((len(xi), len(batch)))

    widths = [samples(run("softmax", LEARNING, seed, chance)).std(0) for seed in range(3)]
    # six widths that scatter by a third each in so many iterations; positive weights alone would leave a fifth
    assert 0.6 < np.mean(widths / (SPACE.width / np.sqrt(12))) < 1.4


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("candidate", ["softmax", "cai"])
def test_exact_losses_end_at_the_truth(candidate, seed):
    """With the default steps: however narrow the flow becomes, the truth stays within it."""
    space = ParameterSpace([Parameter("a", low=0.0, high=10.0), Parameter("b", low=0.0, high=10.0)])
    rows, true = np.random.default_rng(0).normal(size=(30, 2)), np.array([3.0, 7.0])

    def exact(xi, batch):
        return ((xi - true) @ rows[batch].T) ** 2

    made = NfpdeTrainer(exact, 30, 1, space, candidate, NfpdeConfig(iterations=40, samples=300), seed)
    while not made.done:
        made.step()
    xi = space.to_physical(made.flow.sample(500, torch.Generator().manual_seed(9)).numpy())
    assert (xi.std(0) < 0.01 * space.width).all()
    assert (np.abs(xi.mean(0) - true) < 3 * xi.std(0)).all()


@pytest.mark.parametrize(
    ("setting", "text"),
    [
        ({"iterations": 0}, "iterations is 0; it must be an integer of at least 1 (times that samples are drawn"),
        ({"samples": 1}, "samples is 1; it must be an integer of at least 2"),
        ({"samples": 10.0}, "samples is 10.0; it must be an integer"),
        ({"samples": True}, "samples is True; it must be an integer"),
        ({"transitions": 0}, "transitions is 0"),
        ({"horizon": 0}, "horizon is 0"),
        ({"beta": 0.0}, "beta is 0.0; it must be a number of at least 1e-300"),
        ({"beta": -1.0}, "beta is -1.0"),
        ({"beta": float("nan")}, "beta is nan"),
        ({"beta": float("inf")}, "beta is inf"),
        ({"beta": "low"}, "beta is 'low'; it must be a number"),
        ({"least_effective": 0.5}, "least_effective is 0.5; it must be a number of at least 1 ("),
        ({"samples": 10, "least_effective": 11.0}, "least_effective is 11; it can be at most samples, which is 10"),
        ({"clip": -0.1}, "clip is -0.1; it must be a number of at least 0"),
        ({"learning_rate": float("nan")}, "learning_rate is nan"),
        ({"gradient_steps": 0}, "gradient_steps is 0"),
        ({"transforms": 0}, "transforms is 0"),
        ({"hidden": 0}, "hidden is 0"),
        ({"scale": "whiten"}, "scale is 'whiten'; it must be one of 'increment', 'unit' (errors counted in"),
        ({"flow": "glow"}, "flow is 'glow'; it must be one of 'auto', 'realnvp', 'nsf', 'maf'"),
    ],
)
def test_settings_are_checked(setting: dict[str, Any], text):
    """The message names the setting, the value and what it may be."""
    with pytest.raises(BadInput) as caught:
        NfpdeConfig(**setting)
    assert text in str(caught.value)


def test_settings_at_their_limits():
    """The least values are allowed, and a floor above the samples does not matter where beta is given."""
    NfpdeConfig(iterations=1, samples=2, transitions=1, least_effective=1.0, clip=0.0, gradient_steps=1, hidden=1)
    NfpdeConfig(samples=2, beta=1e-300)
    NfpdeConfig(samples=5, least_effective=5)
