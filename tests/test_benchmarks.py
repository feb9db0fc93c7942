"""The paper's robots and populations, and what is recorded of them."""

import json
from dataclasses import replace

import numpy as np
import pytest

from nfpde.benchmarks import ROBOTS, collect, population, robot
from nfpde.benchmarks.targets import draw_robots
from nfpde.dataset import load_dataset, save_dataset
from nfpde.errors import BadInput
from nfpde.sim import MujocoSimulator, model_hash

NAMES = ["hopper", "walker2d", "half_cheetah", "humanoid"]


@pytest.fixture(scope="module")
def recorded():
    """Three robots of each kind, 40 control steps at most."""
    return {name: collect(robot(name), "mixture", episodes=3, steps=40, seed=1) for name in NAMES}


@pytest.mark.parametrize(
    ("name", "masses", "dampings", "friction"),
    [("hopper", 4, 2, 0), ("walker2d", 4, 2, 1), ("half_cheetah", 7, 6, 1), ("humanoid", 13, 17, 0)],
)
def test_parameters_of_table_1(name, masses, dampings, friction):
    """6, 7, 14 and 30 unknowns: masses, joint dampings, floor friction; 50 % around the model's own values."""
    made = robot(name)
    assert list(ROBOTS) == NAMES
    assert [p.field for p in made.space] == (
        ["body_mass"] * masses + ["dof_damping"] * dampings + ["geom_friction"] * friction
    )
    nominal = (made.space.low + made.space.high) / 2
    np.testing.assert_allclose(made.space.width, nominal, rtol=1e-12)
    simulated = MujocoSimulator(made.path, made.space).nominal()
    # the friction of all geoms is one parameter, and they have no common value of their own everywhere
    known = ~np.isnan(simulated)
    assert known[: masses + dampings].all()
    np.testing.assert_allclose(nominal[known], simulated[known], rtol=1e-12)


def test_robots_by_hand():
    """Values read in Gymnasium's model files: damping 1 for all joints of Hopper, friction 0.4 for HalfCheetah."""
    hopper = robot("hopper").space
    assert hopper.names == [
        *("body_mass:torso", "body_mass:thigh", "body_mass:leg", "body_mass:foot"),
        *("dof_damping:thigh_joint", "dof_damping:leg_joint"),
    ]
    np.testing.assert_allclose([hopper.low[4:], hopper.high[4:]], [[0.5, 0.5], [1.5, 1.5]])
    cheetah = robot("half_cheetah")
    np.testing.assert_allclose([cheetah.space.low[-1], cheetah.space.high[-1]], [0.2, 0.6])
    # the file asks for a total mass of 14 kg
    assert cheetah.model.body_mass.sum() == pytest.approx(14.0)
    assert "body_mass:thigh+thigh_left" in robot("walker2d").space.names


@pytest.mark.parametrize("name", NAMES)
def test_recordings_reproduce(recorded, name):
    """One step and eight in a row from recorded states, at the true parameters: the recorded ones to 1e-10.

    Rounding grows by contacts, and the recording's solver starts from its last solution, ours from nothing; with
    another robot's parameters the same steps are far off.
    """
    dataset, truth = recorded[name]
    simulator = MujocoSimulator(robot(name).path, robot(name).space)
    dataset = simulator.prepare(dataset)
    for horizon in (1, 8):
        windows = dataset.windows(horizon)
        index = np.arange(len(windows))
        predicted = simulator.predict(truth.xi, windows)
        np.testing.assert_allclose(predicted[windows.episode, index], windows.target, atol=1e-10)
        others = predicted[(windows.episode + 1) % 3, index]
        assert np.abs(others - windows.target).max() > 1e-2


@pytest.mark.parametrize("name", NAMES)
def test_the_truth_names_its_recordings(recorded, name, tmp_path):
    """Its hash is that of the recordings, as collected and as a fit prepares them from the file."""
    dataset, truth = recorded[name]
    save_dataset(dataset, tmp_path / "data.npz")
    simulator = MujocoSimulator(robot(name).path, robot(name).space, check_influence=False)
    prepared = simulator.prepare(load_dataset(tmp_path / "data.npz"))
    assert truth.dataset == dataset.content_hash() == prepared.content_hash()


@pytest.mark.parametrize("name", NAMES)
def test_recordings_are_whole(recorded, name):
    """As many episodes as asked for, none longer, each named in the truth; facts of the model, solver Newton."""
    dataset, truth = recorded[name]
    assert dataset.names == list(truth.episodes) == ["0", "1", "2"]
    assert all(2 <= len(e) <= 41 for e in dataset)
    model = robot(name).model
    assert (dataset.nq, dataset.nv, dataset.nu) == (model.nq, model.nv, model.nu)
    facts = dataset.metadata
    assert facts.model_hash == model_hash(model)
    assert facts.timestep == model.opt.timestep
    # Humanoid's file asks for PGS, which not every simulator has
    assert facts.solver == "Newton"
    low, high = model.actuator_ctrlrange.T
    for e in dataset:
        assert (e.ctrl >= low).all()
        assert (e.ctrl <= high).all()
    # uniform over the range: sixty commands or more come close to both ends
    ctrl = np.concatenate([e.ctrl for e in dataset])
    assert (ctrl.min(0) < low + 0.2 * (high - low)).all()
    assert (ctrl.max(0) > high - 0.2 * (high - low)).all()


def test_states_are_not_clipped(recorded):
    """Walker2d's observations end at 10 rad/s; the recorded velocities do not."""
    fastest = np.concatenate([e.qvel for e in recorded["walker2d"][0]])
    assert np.abs(fastest).max() > 10.0
    assert not (np.abs(fastest) == 10.0).any()


def test_recording_writes_nothing_else(tmp_path, monkeypatch, capfd):
    """HalfCheetah's file makes MuJoCo warn when it is compiled: neither the console nor the folder shows it."""
    monkeypatch.chdir(tmp_path)
    fresh = replace(robot("half_cheetah"))
    collect(fresh, "gaussian", episodes=1, steps=2)
    assert capfd.readouterr() == ("", "")
    assert list(tmp_path.iterdir()) == []


def test_episodes_end_with_a_fall():
    """Hopper falls within a second; HalfCheetah cannot fall and goes on to the last step."""
    fallen, _ = collect(robot("hopper"), "gaussian", episodes=4, steps=500, seed=0)
    assert all(len(e) < 200 for e in fallen)
    whole, _ = collect(robot("half_cheetah"), "gaussian", episodes=2, steps=60, seed=0)
    assert [len(e) for e in whole] == [61, 61]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("target", ["gaussian", "mixture"])
def test_populations(name, target):
    """One Gaussian, or five on an L of equal weights; every robot inside the box."""
    space = robot(name).space
    people = population(space, target)
    assert people.means.shape == ({"gaussian": 1, "mixture": 5}[target], len(space))
    np.testing.assert_allclose(people.weights, 1 / len(people.weights))
    space.check(draw_robots(space, people, 200, np.random.default_rng(0)))
    if target == "mixture":
        corner, shares = 2, (people.means - space.low) / space.width
        for i in range(len(space)):
            # three means on each arm of the L, which meet in the third
            share = shares[:, i]
            arm = share[:3] if i % 2 else share[2:]
            rest = share[2:] if i % 2 else share[:3]
            np.testing.assert_allclose(rest, share[corner])
            assert len({round(float(s), 9) for s in arm}) == 3


@pytest.mark.parametrize(("n", "counts"), [(10, [2] * 5), (5, [1] * 5), (13, [2, 2, 3, 3, 3]), (3, [0, 0, 1, 1, 1])])
def test_components_are_balanced(n, counts):
    """As equally many robots of each of the five kinds as the number allows, in no order."""
    space = robot("hopper").space
    people = population(space, "mixture")
    orders = set()
    for seed in range(20):
        xi = draw_robots(space, people, n, np.random.default_rng(seed))
        # means are eight standard deviations apart or more
        kind = np.linalg.norm((xi[:, None] - people.means) / space.width, axis=2).argmin(1)
        assert sorted(np.bincount(kind, minlength=5).tolist()) == counts
        orders.add(tuple(kind.tolist()))
    assert len(orders) > 10


def test_the_truth_stays_out_of_the_recordings(tmp_path):
    """No array and no text of data.npz holds a true parameter, the population or the seed that gives them again."""
    seed = 271828
    dataset, truth = collect(robot("hopper"), "mixture", episodes=3, steps=20, seed=seed)
    save_dataset(dataset, tmp_path / "data.npz")
    assert truth.population is not None
    secrets = np.concatenate([truth.xi.ravel(), truth.population.means.ravel()])
    texts = []
    with np.load(tmp_path / "data.npz") as arrays:
        assert set(arrays.files) == {"episode", "time", "qpos", "qvel", "ctrl", "metadata"}
        for array in arrays.values():
            if array.dtype.kind == "f":
                assert not np.isin(array, secrets).any()
            else:
                texts += [str(entry) for entry in array.ravel()]
    text = "\n".join(texts)
    assert not [s for s in truth.xi.ravel() if f"{s:.4g}" in text]
    assert str(seed) not in text
    assert "mixture" not in text
    loaded = load_dataset(tmp_path / "data.npz")
    assert json.loads(loaded.metadata.to_json()) == json.loads(dataset.metadata.to_json())
    assert {e.robot for e in loaded} == {None}


def test_the_robots_model_stays_nominal(recorded):
    """Recording robots with other parameters leaves the nominal model, which fits start from, as it is."""
    for name in NAMES:
        fresh = MujocoSimulator(robot(name).path, robot(name).space, check_influence=False).model
        assert model_hash(fresh) == model_hash(robot(name).model) == recorded[name][0].metadata.model_hash


def test_seeds():
    """Equal seeds record equal numbers, another seed other robots, states and commands."""
    (one, true), (same, also), (other, others) = (
        collect(robot("hopper"), "gaussian", episodes=2, steps=5, seed=s) for s in (4, 4, 5)
    )
    assert one.content_hash() == same.content_hash()
    np.testing.assert_array_equal(true.xi, also.xi)
    assert not np.isin(others.xi, true.xi).any()
    assert not np.isin(other.episodes[0].qpos, one.episodes[0].qpos).all()
    assert not np.isin(other.episodes[0].ctrl, one.episodes[0].ctrl).any()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"episodes": 0}, "episodes, steps and robots must be at least 1, got 0, 150 and 0"),
        ({"steps": 0}, "episodes, steps and robots must be at least 1, got 10, 0 and 10"),
        ({"seed": -1}, "seed must be at least 0, got -1"),
        ({"target": "ring"}, "no target population is called 'ring'; there are: gaussian, mixture"),
    ],
)
def test_refusals(arguments, text):
    """The message names the value and the rule."""
    with pytest.raises(BadInput, match=text):
        collect(robot("hopper"), **({"target": "gaussian"} | arguments))


def test_unknown_robots():
    """The message lists the names."""
    with pytest.raises(BadInput, match="no benchmark robot is called 'ant'; there are: hopper, walker2d, half_cheetah"):
        robot("ant")
