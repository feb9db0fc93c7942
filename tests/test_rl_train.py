"""train_sac: going on after an interruption, what it leaves behind, refusals, and that it learns."""

import json
import random
from dataclasses import asdict
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from nfpde.distribution import ParameterDistribution
from nfpde.effects import effect
from nfpde.errors import BadInput, BadParameter, CheckpointMismatch, SimulationDiverged
from nfpde.flow import GaussianMixture
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.rl import SacConfig, TrainResult, evaluate_policy, load_policy, train_sac
from nfpde.rl.learner import SacLearner, isolated_randomness
from nfpde.rl.randomize import RandomizedParameters
from nfpde.rl.replay import ARRAYS, ReplayFiles
from nfpde.rl.tasks import make_environment
from nfpde.rl.train import PRESETS
from nfpde.truth import Truth

SPACE = ParameterSpace(
    [
        Parameter("body_mass", "pendulum", 0.4, 1.6),
        Parameter("dof_damping", "hinge", 0.0, 0.2),
        *effect("actuation_delay", "motor", delay=(0.0, 0.1)).parameters,
    ]
)
TARGET = [[1.0, 0.1, 0.03], [1.1, 0.09, 0.04]]
SMALL = SacConfig(hidden=(16, 16), batch_size=16, learning_starts=20, learning_rate=1e-3, train_every=4)


def around(xi, width: float = 0.3) -> ParameterDistribution:
    """A Gaussian in z around xi (D,)."""
    z = torch.tensor(SPACE.to_unconstrained([xi]))
    return ParameterDistribution(SPACE, GaussianMixture(torch.ones(1), z, width**2 * torch.eye(len(SPACE))[None]))


def train(out: Path, steps: int = 480, **change: Any) -> TrainResult:
    arguments: dict[str, Any] = {
        "target": TARGET,
        "evaluation_every": 160,
        "evaluation_episodes": 2,
        "hyperparameters": SMALL,
        "device": "cpu",
        "quiet": True,
    }
    return train_sac("pendulum", around(TARGET[0]), steps=steps, out=out, **{**arguments, **change})


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A training of three rounds without interruption."""
    return train(tmp_path_factory.mktemp("whole"))


def same(first, second) -> None:
    assert first.points == second.points
    for name, weight in first.policy.weights.items():
        np.testing.assert_array_equal(weight, second.policy.weights[name])


@pytest.mark.parametrize("step", [1, 200, 470])
def test_interrupted_equals_uninterrupted(whole, tmp_path, monkeypatch, step):
    """Stopped within any round and started again: the same weights and returns to the last bit."""

    class Stop(Exception):
        pass

    inner = RandomizedParameters.step
    count = 0

    def stopping(self, action):
        nonlocal count
        if self.source is not None and not isinstance(self.source, np.ndarray):
            # of the training environment's steps, those of the first evaluations come before
            count += 1
        if count == step + 300 * (1 + step // 160):
            raise Stop
        return inner(self, action)

    with monkeypatch.context() as patch:
        patch.setattr(RandomizedParameters, "step", stopping)
        with pytest.raises(Stop):
            train(tmp_path)
    monkeypatch.setattr(RandomizedParameters, "step", inner)
    same(train(tmp_path), whole)


def test_going_on_equals_one_training(whole, tmp_path):
    """Two rounds, then a third with more steps: the same as three at once; a finished training is left alone."""
    train(tmp_path, 320)
    same(train(tmp_path), whole)
    before = (tmp_path / "state.safetensors").read_bytes()
    same(train(tmp_path), whole)
    assert (tmp_path / "state.safetensors").read_bytes() == before
    with pytest.raises(BadInput, match="holds a training of 480 control steps already"):
        train(tmp_path, 100)


def test_ctrl_c_keeps_the_last_round(tmp_path, monkeypatch):
    """Ctrl-C says what is kept, and a kill while files were being written does no harm."""
    calls = []

    def interrupt(self, steps, seed, report):
        calls.append(steps)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return inner(self, steps, seed, report)

    inner = SacLearner.run_round
    monkeypatch.setattr(SacLearner, "run_round", interrupt)
    with pytest.raises(KeyboardInterrupt, match="holds the state after 160 control steps"):
        train(tmp_path)
    assert load_policy(tmp_path).nobservation == 5  # and two past commands, which the delay holds back
    (tmp_path / "replay" / "000000000160-000000000320.npz").write_bytes(b"half")
    (tmp_path / "replay" / "000000000160-000000000320.tmp").write_bytes(b"half")
    assert train(tmp_path).after.step == 480
    assert sorted(p.name for p in (tmp_path / "replay").iterdir()) == [
        f"{i:012d}-{i + 160:012d}.npz" for i in (0, 160, 320)
    ]


def test_what_is_said_is_kept_is_kept(tmp_path, monkeypatch):
    """Stopped before anything was saved, or while transitions are written: the message says where it stands."""

    def stop(*_args):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(SacLearner, "run_round", stop)
        with pytest.raises(KeyboardInterrupt, match="nothing was saved yet: the same call starts afresh"):
            train(tmp_path)
    assert not list(tmp_path.iterdir())
    train(tmp_path, 160)
    monkeypatch.setattr(ReplayFiles, "add", stop)
    with pytest.raises(KeyboardInterrupt, match="holds the state after 160 control steps"):
        train(tmp_path)


@pytest.mark.parametrize("seed", [1, 2**32 + 5, 2**63 - 1])
def test_another_seed_gives_another_policy(whole, tmp_path, seed):
    """The seed matters: nothing above is equal because everything is; seeds as large as those of fits are taken."""
    other = train(tmp_path, 160, seed=seed)
    assert not np.array_equal(other.policy.weights["mean.weight"], whole.policy.weights["mean.weight"])
    assert other.points[0] != whole.points[0]


def test_global_state_is_given_back(tmp_path):
    """Training leaves the global generators and torch's threads as they were."""
    torch.set_num_threads(2)
    random.seed(5)
    np.random.seed(5)  # noqa: NPY002
    torch.manual_seed(5)
    expected = random.random(), np.random.rand(), torch.rand(1).item()  # noqa: NPY002
    random.seed(5)
    np.random.seed(5)  # noqa: NPY002
    torch.manual_seed(5)
    train(tmp_path, 160)
    assert (random.random(), np.random.rand(), torch.rand(1).item()) == expected  # noqa: NPY002
    assert torch.get_num_threads() == 2


def test_outputs(whole):
    """The folder holds what the documentation says, without pickle, and the JSON says what the result does."""
    names = {p.name for p in whole.folder.iterdir()}
    assert names == {
        "policy.json", "policy.safetensors", "replay", "returns.png", "state.json", "state.safetensors", "train.json"
    }  # fmt: skip
    content = json.loads((whole.folder / "train.json").read_text())
    assert [p["step"] for p in content["points"]] == [0, 160, 320, 480]
    assert content["points"][-1]["target"]["mean"] == whole.after.target.mean
    assert content["settings"]["environment"] == "nfpde/Pendulum-v0"
    assert (whole.folder / "returns.png").read_bytes()[:4] == b"\x89PNG"
    # rounds of 160 steps hold one whole episode of 150
    assert [p.episodes for p in whole.points] == [0, 1, 1, 1]
    policy = load_policy(whole.folder)
    again = evaluate_policy(policy, "pendulum", TARGET, space=SPACE, episodes=2)
    assert (again.mean, again.standard_error) == (whole.after.target.mean, whole.after.target.standard_error)


def test_nominal_baseline(tmp_path):
    """The policy trained on the nominal model is another one, evaluated on the same target, and in the report."""
    truth = Truth(SPACE, np.array(TARGET), ["a", "b"])
    result = train(tmp_path, 160, nominal_baseline=True, target=truth, past_commands=0)
    assert result.baseline is not None
    assert result.baseline.before.target == result.before.target  # same untrained policy, same robots
    assert result.baseline.before.training != result.before.training
    assert not np.array_equal(result.baseline.policy.weights["mean.bias"], result.policy.weights["mean.bias"])
    assert "trained on the nominal model" in result.summary()
    mine, theirs = result.after.target, result.baseline.after.target
    assert mine is not None
    assert theirs is not None
    ahead = mine.ahead_of(theirs)
    assert ahead is not None
    difference = np.array(mine.returns) - np.array(theirs.returns)
    # two episodes: the standard error of a mean of two is half their distance
    np.testing.assert_allclose(ahead, [difference.mean(), abs(difference[0] - difference[1]) / 2], rtol=1e-12)
    assert json.loads((tmp_path / "train.json").read_text())["nominal_baseline"]["points"][-1]["step"] == 160
    assert load_policy(tmp_path / "nominal").nobservation == 3


def test_target_of_another_space(tmp_path):
    """The target may have parameters that training does not know, friction here; it changes the target's return."""
    wide = ParameterSpace([Parameter("dof_frictionloss", "hinge", 0.0, 1.0)])
    plain, rubbing = (train(tmp_path / f"{x}", 4, target=Truth(wide, np.array([[x]]), ["a"])) for x in (0.0, 0.9))
    assert plain.before.training == rubbing.before.training
    assert plain.before.target != rubbing.before.target


def test_another_training_in_the_folder_is_refused(whole):
    """A folder of another training: refused with what differs, whatever it is."""
    changes: list[tuple[dict[str, Any], str]] = [
        ({"seed": 4}, "seed: saved 0, now 4"),
        ({"evaluation_every": 200}, "evaluation_every: saved 160, now 200"),
        ({"target": [TARGET[0]]}, "target.xi"),
        ({"hyperparameters": SacConfig(hidden=(8,), train_every=4)}, "hyperparameters.hidden"),
    ]
    for change, text in changes:
        with pytest.raises(CheckpointMismatch, match=text):
            train(whole.folder, **change)
    with pytest.raises(CheckpointMismatch, match="parameters: saved"):
        train_sac(
            "pendulum", around(TARGET[1]), steps=480, out=whole.folder, target=TARGET, evaluation_every=160,
            evaluation_episodes=2, hyperparameters=SMALL, quiet=True,
        )  # fmt: skip


def test_missing_transitions_are_refused(tmp_path):
    """A file of transitions that is gone or damaged: refused by name, never trained without."""
    train(tmp_path, 320)
    first, second = sorted((tmp_path / "replay").iterdir())
    whole = second.read_bytes()
    for kept in (len(whole) // 2, 0):
        second.write_bytes(whole[:kept])
        with pytest.raises(BadInput, match=f"{second.name} is damaged"):
            train(tmp_path)
    first.unlink()
    with pytest.raises(BadInput, match="transitions 0 to 320 are missing"):
        train(tmp_path)


@pytest.mark.parametrize("size", [7, 20, 64, 1000])
def test_replay_files_restore_the_ring(tmp_path, size):
    """A ring saved in pieces is restored as it was, wherever it wrapped, and files no longer needed go."""
    from stable_baselines3.common.buffers import ReplayBuffer

    box = gymnasium.spaces.Box(-1, 1, (2,))
    rng = np.random.default_rng(0)
    buffer, files, done = ReplayBuffer(size, box, box, device="cpu"), ReplayFiles(tmp_path), [0]
    for piece in (5, 11, 30, 1, 18):
        for i in range(done[-1], done[-1] + piece):
            o, a = rng.normal(size=(1, 2)), rng.normal(size=(1, 2))
            info = [{"TimeLimit.truncated": i % 3 == 0}]
            buffer.add(o, o + 1, a, np.array([float(i)]), np.array([i % 2 == 0]), info)
        done.append(done[-1] + piece)
        files.add(buffer, *done[-2:])
        files.clean(size, done[-1])
        copy = ReplayBuffer(size, box, box, device="cpu")
        files.load(copy, done)
        assert (copy.pos, copy.full) == (buffer.pos, buffer.full)
        for name in ARRAYS:
            np.testing.assert_array_equal(getattr(copy, name), getattr(buffer, name))
    kept = sum(int(p.stem[13:]) - int(p.stem[:12]) for p in tmp_path.iterdir())
    assert kept < size + 30


def test_divergence_is_recorded_and_stops_training(tmp_path, monkeypatch):
    """A target that blows up has no return; a training where it happens often stops."""
    from nfpde import live

    inner = live.LivePhysics._simulate

    def broken(self, ctrl, n_frames):
        if self.env.model.body_mass[1] == 1.0:
            raise live.PhysicsDiverged
        inner(self, ctrl, n_frames)

    monkeypatch.setattr(live.LivePhysics, "_simulate", broken)
    result = train(tmp_path / "a", 160, target=[TARGET[0]])
    assert result.after.target is not None
    assert (result.after.target.mean, str(result.after.target)) == (None, "diverged")
    assert result.after.target.problem is not None
    assert "'body_mass:pendulum': 1.0" in result.after.target.problem
    with pytest.raises(SimulationDiverged, match=r"diverged in 160 of the 160 episodes up to control step 160"):
        train_sac("pendulum", TARGET[0], steps=200, out=tmp_path / "b", space=SPACE, evaluation_every=160,
                  hyperparameters=SMALL, quiet=True)  # fmt: skip


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ({"steps": 0}, BadInput, "steps is 0"),
        ({"steps": 10}, BadInput, "steps is 10; it must be a multiple of train_every, 4"),
        ({"seed": -1}, BadInput, "seed is -1"),
        ({"seed": 10**22}, BadInput, r"seed is 10000000000000000000000; it must be an integer from 0 to 922337"),
        ({"threads": 0}, BadInput, "threads is 0"),
        ({"evaluation_every": 100}, BadInput, "at least an episode of nfpde/Pendulum-v0, 150 control steps"),
        ({"evaluation_episodes": 1}, BadInput, "evaluation_episodes is 1"),
        ({"target": [[1.0, 0.1]]}, BadParameter, r"shape \(n, 3\)"),
        ({"target": [[1.0, np.nan, 0.0]]}, BadParameter, "dof_damping:hinge = nan"),
        ({"target": around(TARGET[0])}, BadInput, "not a distribution"),
        ({"model": "none.xml"}, BadInput, "none.xml: no such file"),
        ({"device": "gpu"}, BadInput, "device is 'gpu'; networks train on 'cpu'"),
    ],
)
def test_bad_arguments(tmp_path, change, error, text):
    """Arguments that cannot be used are refused by message."""
    with pytest.raises(error, match=text):
        train(tmp_path, **change)


def test_cuda_is_not_replaced_in_silence(tmp_path, monkeypatch):
    """Asked for CUDA where there is none, training is refused."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(BadInput, match="device 'cuda': PyTorch finds no CUDA device"):
        train(tmp_path, device="cuda")


def test_poisoned_distribution_is_refused(tmp_path):
    """A distribution that returns NaN, or leaves its box, is refused at the first draw."""

    class Poisoned:
        space = SPACE

        def sample(self, n: int, seed: int = 0):
            return np.full((n, 3), np.nan)

    with pytest.raises(BadParameter, match="nan lies outside"):
        train_sac("pendulum", Poisoned(), steps=200, out=tmp_path, quiet=True)
    with pytest.raises(BadInput, match="without a space"):
        train_sac("pendulum", None, steps=200, out=tmp_path, quiet=True)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"hidden": (0,)}, r"hidden\[0\] is 0"),
        ({"batch_size": 1.5}, "batch_size is 1.5"),
        ({"learning_rate": float("nan")}, "learning_rate is nan"),
        ({"gamma": 1.5}, "gamma is 1.5"),
        ({"entropy": "never"}, "entropy is 'never'"),
        ({"entropy": -1.0}, "entropy is -1.0"),
        ({"learning_starts": -1}, "learning_starts is -1"),
    ],
)
def test_bad_hyperparameters(change, text):
    """Settings that make no sense are refused where they are written."""
    with pytest.raises(BadInput, match=text):
        SacConfig(**change)


def test_presets(tmp_path):
    """Without hyperparameters an environment's preset counts, whichever of its names is used."""
    for name in ("pendulum", "nfpde/Pendulum-v0"):
        result = train_sac(
            name, TARGET[0], steps=4, out=tmp_path / name, space=SPACE, evaluation_episodes=2, quiet=True
        )
        assert result.settings["hyperparameters"] == asdict(PRESETS["nfpde/Pendulum-v0"])


def test_fixed_entropy_coefficient(tmp_path):
    """A number for the entropy coefficient trains and goes on, too."""
    config = SacConfig(hidden=(8,), batch_size=8, learning_starts=10, train_every=4, entropy=0.1)
    train(tmp_path / "a", 160, hyperparameters=config)
    first = train(tmp_path / "a", 320, hyperparameters=config)
    same(first, train(tmp_path / "b", 320, hyperparameters=config))


def test_environments_sac_cannot_use_are_refused():
    """Actions without bounds: refused."""
    env = make_environment("pendulum")
    env.unwrapped.action_space = gymnasium.spaces.Box(-np.inf, np.inf, (1,))
    with isolated_randomness(1), pytest.raises(BadInput, match="bounded actions"):
        SacLearner(env, SMALL, steps=10)


@pytest.mark.slow
def test_pendulum_is_solved(tmp_path):
    """Within half a CPU minute: trained on an estimate of mass and damping, the pendulum is solved in the target."""
    space = ParameterSpace(SPACE.parameters[:2])
    z = torch.tensor(space.to_unconstrained([[1.15, 0.11]]))
    estimate = ParameterDistribution(space, GaussianMixture(torch.ones(1), z, 0.1 * torch.eye(2)[None]))
    result = train_sac(
        "pendulum", estimate, steps=8000, out=tmp_path, target=[1.2, 0.12], nominal_baseline=False, device="cpu"
    )
    print(result.summary())
    # starts are anywhere on the circle: always upright earns 150, hanging about 0, swinging to and fro below 75
    before, after = result.before.target, result.after.target
    assert before is not None
    assert after is not None
    assert before.mean is not None
    assert after.mean is not None
    assert before.mean < 60
    assert after.mean > 100
