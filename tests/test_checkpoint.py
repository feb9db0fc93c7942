"""Saving and loading the state of a long job."""

import json
import os
import re

import numpy as np
import pytest
import torch

from nfpde import storage
from nfpde.checkpoint import flatten_state, load_state, restore_state, save_state
from nfpde.errors import BadInput, CheckpointMismatch

RUN = {"data": "abc", "settings": {"beta": 0.1, "sizes": [64, 64]}}


def state(value):
    return {"w": torch.full((3,), float(value), dtype=torch.float64)}, {"run": RUN, "step": value}


def test_tensors_and_info_come_back_bit_for_bit(tmp_path):
    """Values, dtypes, shapes and JSON are unchanged, for views and empty tensors too."""
    x = torch.randn(4, 3, dtype=torch.float64)
    tensors = {
        "x": x,
        "view": x.T,
        "same": x,
        "nan": torch.tensor([float("nan"), -0.0]),
        "none": torch.empty(0, 2),
        "bytes": torch.arange(5, dtype=torch.uint8),
    }
    save_state(tmp_path / "new" / "run", tensors, {"step": 3, "best": 0.1 + 0.2})
    loaded = load_state(tmp_path / "new" / "run")
    assert loaded is not None
    back, info = loaded
    assert info == {"step": 3, "best": 0.1 + 0.2}
    assert back.keys() == tensors.keys()
    for key, t in tensors.items():
        assert back[key].dtype == t.dtype
        assert back[key].shape == t.shape
        assert back[key].numpy().tobytes() == t.contiguous().numpy().tobytes()


def test_nothing_saved_is_none(tmp_path):
    """A new folder, existing or not, has no state."""
    assert load_state(tmp_path) is None
    assert load_state(tmp_path / "missing") is None


# one save syncs file and folder for each of its two files, and opens and renames each once
MOMENTS = [("fsync", n) for n in range(4)] + [(f, n) for f in ("open", "replace") for n in range(2)]


@pytest.mark.parametrize(("function", "call"), MOMENTS)
def test_a_kill_at_any_moment_leaves_a_whole_state(tmp_path, monkeypatch, function, call):
    """Whichever write, sync or rename is the last one begun, loading gives the old or the new state, whole."""

    class Killed(BaseException):
        pass

    where = os if function == "fsync" else storage.Path
    original = getattr(where, function)
    calls = 0

    def dies(*args, **kwargs):
        nonlocal calls
        calls += 1
        if calls - 1 < call:
            return original(*args, **kwargs)
        if function == "open":  # half of the data reaches the file
            with original(*args, **kwargs) as file:
                file.write(b"half")
        raise Killed

    save_state(tmp_path, *state(1))
    with monkeypatch.context() as patch:
        patch.setattr(where, function, dies)
        with pytest.raises(Killed):
            save_state(tmp_path, *state(2))
    loaded = load_state(tmp_path, RUN)
    assert loaded is not None
    tensors, info = loaded
    renamed = call > 0  # with every function the second call comes after the first rename
    assert info["step"] == (2 if renamed else 1)
    assert torch.equal(tensors["w"], state(info["step"])[0]["w"])
    save_state(tmp_path, *state(3))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["state.json", "state.safetensors"]
    assert json.loads((tmp_path / "state.json").read_text())["step"] == 3


def test_another_run_is_refused_with_both_values(tmp_path):
    """The message names every entry that differs, with the saved value and the new one, and nothing else."""
    save_state(tmp_path, *state(1))
    assert load_state(tmp_path, {"data": "abc", "settings": {"beta": 0.1, "sizes": (64, 64)}}) is not None
    with pytest.raises(CheckpointMismatch) as error:
        load_state(tmp_path, {"data": "abc", "settings": {"beta": 0.2, "sizes": [64, 64]}, "seed": 4})
    text = str(error.value)
    assert "settings.beta: saved 0.1, now 0.2" in text
    assert "seed: saved nothing, now 4" in text
    assert "data" not in text.split("\n", 1)[1].split("Use the same")[0]
    assert "sizes" not in text
    with pytest.raises(CheckpointMismatch) as error:
        load_state(tmp_path, {"data": "abc", "settings": {"beta": 0.1, "sizes": [64, 32, 8]}})
    assert re.findall(r"^  .*", str(error.value), re.MULTILINE) == [
        "  settings.sizes[1]: saved 64, now 32",
        "  settings.sizes[2]: saved nothing, now 8",
    ]
    with pytest.raises(CheckpointMismatch, match="\n  and 20 entries more\nUse the same"):
        load_state(tmp_path, {"data": "abc", "settings": {"beta": 0.1, "sizes": list(range(40))}})
    save_state(tmp_path, {}, {"step": 1})
    with pytest.raises(CheckpointMismatch, match=r'data: saved nothing, now "abc"'):
        load_state(tmp_path, RUN)


def test_damage_is_refused(tmp_path):
    """A file cut short, or another safetensors file, is an error that says what to do."""
    save_state(tmp_path, *state(1))
    path = tmp_path / "state.safetensors"
    path.write_bytes(path.read_bytes()[:-7])
    with pytest.raises(BadInput, match=r"state\.safetensors is not a saved state or is damaged .* Delete it"):
        load_state(tmp_path)


def test_info_must_be_json(tmp_path):
    """What JSON cannot hold is refused before anything is written."""
    for value in (float("nan"), float("inf"), np.float32(1), object()):
        with pytest.raises(BadInput, match="must be JSON"):
            save_state(tmp_path, {}, {"loss": value})
    assert list(tmp_path.iterdir()) == []


def test_nested_states_come_back(tmp_path):
    """Types, integer keys, tuples, infinities and big integers survive the file."""
    nested = {
        0: {"step": torch.tensor(3.0), "a": np.arange(4, dtype=np.uint32)},
        "groups": [{"betas": (0.9, 0.999), "best": float("inf"), "on": True, "none": None}],
        "big": 2**127 + 1,
        "empty": {},
    }
    tensors, layout = flatten_state("s", nested)
    save_state(tmp_path, tensors, {"s": layout})
    loaded = load_state(tmp_path)
    assert loaded is not None
    back = restore_state(loaded[1]["s"], loaded[0])
    assert torch.equal(back[0].pop("step"), nested[0].pop("step"))
    np.testing.assert_array_equal(back[0]["a"], nested[0]["a"])
    assert back[0].pop("a").dtype == nested[0].pop("a").dtype
    assert back == nested
    with pytest.raises(BadInput, match="'s' holds a set"):
        flatten_state("s", {"x": {1, 2}})


@pytest.mark.parametrize("bits", [np.random.PCG64, np.random.MT19937, np.random.Philox])
def test_generators_go_on(tmp_path, bits):
    """Generators restored from the file draw the very numbers the first ones draw next."""
    rng, generator = np.random.Generator(bits(5)), torch.Generator().manual_seed(6)
    rng.random(7)
    torch.rand(7, generator=generator)
    tensors, layout = flatten_state("rng", rng.bit_generator.state)
    save_state(tmp_path, {**tensors, "torch": generator.get_state()}, {"rng": layout})
    loaded = load_state(tmp_path)
    assert loaded is not None
    rng2, generator2 = np.random.Generator(bits(0)), torch.Generator()
    rng2.bit_generator.state = restore_state(loaded[1]["rng"], loaded[0])
    generator2.set_state(loaded[0]["torch"])
    np.testing.assert_array_equal(rng2.random(9), rng.random(9))
    assert torch.equal(torch.rand(9, generator=generator2), torch.rand(9, generator=generator))


def test_training_that_stops_and_goes_on_is_bit_identical(tmp_path):
    """Ten steps at once and five, a save, a load and five more give the same weights and the same loss."""

    def make():
        net = torch.nn.Linear(3, 1, dtype=torch.float64)
        torch.nn.init.ones_(net.weight)
        torch.nn.init.zeros_(net.bias)
        optimizer = torch.optim.AdamW(net.parameters(), lr=0.1)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, 10)
        return net, optimizer, schedule, torch.Generator().manual_seed(0)

    def steps(n, net, optimizer, schedule, generator):
        loss = torch.zeros(())
        for _ in range(n):
            x = torch.randn(8, 3, generator=generator, dtype=torch.float64)
            loss = ((net(x) - x.sum(1, keepdim=True)) ** 2).mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
        return loss

    whole = make()
    loss = steps(10, *whole)
    first = make()
    steps(5, *first)
    states = {"net": first[0].state_dict(), "optimizer": first[1].state_dict(), "schedule": first[2].state_dict()}
    tensors, layout = flatten_state("job", {**states, "generator": first[3].get_state()})
    save_state(tmp_path, tensors, {"job": layout})
    loaded = load_state(tmp_path)
    assert loaded is not None
    job = restore_state(loaded[1]["job"], loaded[0])
    second = make()
    for part, key in zip(second[:3], ("net", "optimizer", "schedule"), strict=True):
        part.load_state_dict(job[key])
    second[3].set_state(job["generator"])
    assert torch.equal(steps(5, *second), loss)
    assert torch.equal(second[0].weight, whole[0].weight)
