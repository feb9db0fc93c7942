"""What was simulated before a stop: read back to the bit, and simulated anew wherever anything differs."""

import os
import resource
import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from nfpde.bench import code
from nfpde.effects import Effect, Quantity, effect
from nfpde.errors import BadDataset, BadInput
from nfpde.gap import Journal, diagnose_gap, identity, journal
from nfpde.gap.recall import Recall
from nfpde.gap.replay import Replay
from nfpde.parameters import Parameter, ParameterSpace
from tests.gap_cart import cart, cart_windows
from tests.gap_systems import nominal, record

XI = np.array([[1.0, 0.2], [1.5, 0.4]])


def mass(**options):
    return ParameterSpace([Parameter("body_mass", "cart", 0.5, 2.0, scale_inertia=False, **options)])


def friction():
    return effect("coulomb_friction", "slide", torque=(0.0, 1.0))


def replay(journal=None, model=None, space=None, effects=None):
    """A model of one's own, as a process has it that knows nothing but the file."""
    effects = [friction()] if effects is None else effects
    return Replay(model or cart(), space or mass(), effects, nthread=1, recall=Recall(journal=journal))


@pytest.fixture
def windows():
    return cart_windows()


def simulated(one, monkeypatch):
    """Rows that the simulator of a replay is asked for from here on."""
    asked, predict = [], one.sim.predict
    monkeypatch.setattr(one.sim, "predict", lambda xi, w: asked.append(len(xi)) or predict(xi, w))
    return asked


def stopped(folder, work, **options):
    """Work with the journal of a folder that is stopped at its end."""

    def plugged():
        with Journal(folder, **options) as kept:
            work(kept)
            raise RuntimeError("the plug was pulled")

    with pytest.raises(RuntimeError, match="pulled"):
        plugged()


def test_what_was_simulated_is_read(tmp_path, windows, monkeypatch):
    """Two rows are known and a third is not: the same numbers, to the bit, and the same count of steps."""
    stopped(tmp_path, lambda kept: replay(kept).predict(XI, windows))
    three = np.vstack([XI, [[0.7, 0.1]]])
    alone = replay()
    wanted = alone.predict(three, windows)
    with Journal(tmp_path) as kept:
        one = replay(kept)
        asked = simulated(one, monkeypatch)
        np.testing.assert_array_equal(one.predict(three, windows), wanted)
        np.testing.assert_array_equal(one.predict(three[::-1], windows), wanted[::-1])
    assert sum(asked) == 1
    assert one.sim.simulated_steps == alone.sim.simulated_steps


class Wind(Effect):
    """An effect of a user's own."""

    name = "test_wind"
    kind = "joint"
    quantities = (Quantity("force", "N", -9.0, 9.0, neutral=0.0),)
    sentence = "Wind."

    def step(self, world, rows, values):
        world.qfrc_applied[rows, self.dofs[0]] += values[:, 0]


class Draught(Wind):
    """Another that does the same."""


@pytest.mark.parametrize(
    ("before", "now", "alike"),
    [
        ({}, {}, True),
        ({}, {"effects": [friction()]}, True),
        ({}, {"model": cart(mass=2)}, False),
        ({}, {"space": mass(relative=True)}, False),
        ({}, {"space": mass(unit="g")}, False),  # does the same, but nobody would miss it
        ({}, {"effects": [effect("viscous_damping", "slide", damping=(0.0, 1.0))]}, False),
        ({"effects": [Wind("slide", force=(-1, 1))]}, {"effects": [Wind("slide", force=(-1, 1))]}, True),
        ({"effects": [Wind("slide", force=(-1, 1))]}, {"effects": [Draught("slide", force=(-1, 1))]}, False),
    ],
)
def test_models_are_told_apart_by_their_content(tmp_path, windows, monkeypatch, before, now, alike):
    stopped(tmp_path, lambda kept: replay(kept, **before).predict(XI, windows))
    with Journal(tmp_path) as kept:
        one = replay(kept, **now)
        asked = simulated(one, monkeypatch)
        np.testing.assert_array_equal(one.predict(XI, windows), replay(**now).predict(XI, windows))
    assert (sum(asked) == 0) == alike


def test_what_is_taken_is_told_apart(tmp_path, windows, monkeypatch):
    """Steps, forces, windows and parameters: each has numbers of its own."""

    def work(kept):
        one = replay(kept)
        one.predict(XI, windows)

    stopped(tmp_path, work)
    with Journal(tmp_path) as kept:
        one, alone = replay(kept), replay()
        asked = simulated(one, monkeypatch)
        calls = [
            (XI, windows, None, np.array([2])),
            (XI, windows, np.ones((2, 1)), None),
            (XI, windows[1:], None, None),
            (XI + 1e-12, windows, None, None),
            (XI, replace(windows, history=windows.history + 1), None, None),
        ]
        for number, call in enumerate(calls, 1):
            np.testing.assert_array_equal(one.predict(*call), alone.predict(*call))
            assert sum(asked) == 2 * number
        one.predict(XI, windows)
        assert sum(asked) == 2 * len(calls)


def test_an_effect_that_cannot_be_compared_is_like_no_other(tmp_path, windows, monkeypatch):
    """One that holds a function, and one whose class is written nowhere."""
    holding = Wind("slide", force=(-1, 1))
    vars(holding)["profile"] = lambda t: t
    space = {}
    exec("class Typed(Wind):\n    pass", {"Wind": Wind, "__name__": "nowhere"}, space)
    for number, own in enumerate((holding, space["Typed"]("slide", force=(-1, 1)))):
        folder = tmp_path / str(number)
        stopped(folder, lambda kept, own=own: replay(kept, effects=[own]).predict(XI, windows))
        identity._text.cache_clear()  # as in another process
        with Journal(folder) as kept:
            one = replay(kept, effects=[own])
            asked = simulated(one, monkeypatch)
            one.predict(XI, windows)
        assert sum(asked) == len(XI)


def test_what_is_torn_or_damaged_is_simulated_anew(tmp_path, windows):
    """Cut anywhere, with a bit turned anywhere, or with zeros behind: the numbers are right, and more can be kept."""
    stopped(tmp_path, lambda kept: replay(kept).predict(XI, windows))
    path, wanted = tmp_path / journal.FILE, replay().predict(XI, windows)
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    cut = [whole[:size] for size in (0, 1, 23, 24, 25, 60, len(whole) - 1, *rng.integers(len(whole), size=8))]
    turned = [bytearray(whole) for _ in range(24)]
    for content, place in zip(turned, rng.integers(len(whole), size=24), strict=True):
        content[place] ^= 1 << rng.integers(8)
    for content in (*cut, *turned, whole + bytes(500), b"something else entirely" * 9):
        path.write_bytes(content)
        stopped(tmp_path, lambda kept: np.testing.assert_array_equal(replay(kept).predict(XI, windows), wanted))
        with Journal(tmp_path) as kept:
            np.testing.assert_array_equal(replay(kept).predict(XI, windows), wanted)


def test_a_file_of_other_code_begins_afresh(tmp_path, windows, monkeypatch):
    stopped(tmp_path, lambda kept: replay(kept).predict(XI, windows))
    monkeypatch.setattr(journal, "_head", lambda: b"nfpde 1\n" + bytes(16))
    with Journal(tmp_path) as kept:
        one = replay(kept)
        asked = simulated(one, monkeypatch)
        one.predict(XI, windows)
    assert sum(asked) == len(XI)


def test_all_that_makes_predictions_counts():
    """Whatever a replay's file imports, and what that imports, but for errors and files, and memory."""
    places = [code.PACKAGE / place for place in journal.PREDICTS]
    assert all(place.exists() for place in places)
    needed = code.with_imports([code.PACKAGE / "gap" / "replay.py"])
    others = {p for p in needed if not any(p.is_relative_to(place) for place in places)}
    assert {p.name for p in others} == {"errors.py", "storage.py", "heap.py", "shelf.py"}


@pytest.mark.parametrize(
    ("error", "stays"), [(None, False), (BadDataset, False), (KeyboardInterrupt, True), (MemoryError, True)]
)
def test_the_file_goes_with_an_end(tmp_path, windows, error, stays):
    """With an answer and with an error of input; whatever else happens, it stays, and the lock never does."""

    def block():
        with Journal(tmp_path / "out") as kept:
            replay(kept).predict(XI, windows)
            if error is not None:
                raise error("so it ended")

    if error is None:
        block()
    else:
        said = "the same call goes on" if error is KeyboardInterrupt else "so it ended"
        with pytest.raises(error, match=said):
            block()
    assert [p.name for p in tmp_path.glob("out/*")] == ([journal.FILE] if stays else [])


def test_an_interrupt_before_anything_was_kept_promises_nothing(tmp_path):
    with pytest.raises(KeyboardInterrupt, match=r"^$"), Journal(tmp_path):
        raise KeyboardInterrupt


def test_one_process_at_a_time(tmp_path):
    with Journal(tmp_path), pytest.raises(BadInput, match="another process is at work there"), Journal(tmp_path):
        pass


def test_what_has_no_room_is_told_once(tmp_path, windows, monkeypatch):
    """A file that is full, and a disk that is: predictions are right, and what was kept before is read."""
    told, wanted = [], replay().predict(XI, windows)
    row = wanted[0].nbytes + 50
    stopped(tmp_path, lambda kept: replay(kept).predict(XI, windows), report=told.append, most=60 + row)
    assert len(told) == 1
    assert "unfinished.bin has" in told[0]
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    other = tmp_path / "other"

    def work(kept):
        one = replay(kept)
        one.predict(XI[:1], windows)
        resource.setrlimit(resource.RLIMIT_FSIZE, (kept.path.stat().st_size + 10, hard))
        try:
            np.testing.assert_array_equal(one.predict(XI, windows), wanted)
            one.predict(XI + 0.1, windows)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))

    told.clear()
    stopped(other, work, report=told.append)
    assert len(told) == 1
    for folder in (tmp_path, other):
        with Journal(folder) as kept:
            one = replay(kept)
            asked = simulated(one, monkeypatch)
            np.testing.assert_array_equal(one.predict(XI, windows), wanted)
        assert sum(asked) == 1


KILLED = """
import os, signal, sys
from nfpde import ParameterSpace
from nfpde.gap import Journal, diagnose_gap
from nfpde.parameters import Parameter
from tests.gap_cart import cart, cart_windows
from tests.gap_systems import nominal, record

left = [int(sys.argv[2])]

def told(what):
    left[0] -= 1
    if not left[0]:
        os.kill(os.getpid(), signal.SIGKILL)

with Journal(sys.argv[1]) as journal:
    data = record(force=lambda d: -3.0 * (d.qpos[1] - 0.2), noise=1e-3, seed=5)
    space = ParameterSpace([Parameter("body_mass", "fore", 0.5, 2.0)])
    diagnose_gap(nominal(), data, space, windows=60, journal=journal, report=told)
"""


def test_a_killed_diagnosis_goes_on(tmp_path, monkeypatch):
    """Killed twice, the second time later: the answer of one that never was, to the bit, most of it read."""
    for messages in (4, 5):
        ended = subprocess.run([sys.executable, "-c", KILLED, tmp_path, str(messages)], check=False)
        assert ended.returncode == -signal.SIGKILL
    data = record(force=lambda d: -3.0 * (d.qpos[1] - 0.2), noise=1e-3, seed=5)
    space = ParameterSpace([Parameter("body_mass", "fore", 0.5, 2.0)])

    def answer(kept):
        content = diagnose_gap(nominal(), data, space, windows=60, journal=kept).to_json()
        return content.pop("seconds"), content

    read, get = [], Journal.get
    monkeypatch.setattr(Journal, "get", lambda *args: read.append(get(*args) is not None) or get(*args))
    with Journal(tmp_path) as kept:
        before = kept.seconds
        seconds, resumed = answer(kept)
    assert resumed == answer(None)[1]
    assert np.mean(read) > 0.3
    assert seconds > before > 0
    assert os.listdir(tmp_path) == []
