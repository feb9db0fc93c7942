"""How loud noise is in single windows, and beside which model."""

import mujoco
import numpy as np
import pytest

from nfpde.bench.gap.draw import draw_system
from nfpde.bench.gap.store import write_public
from nfpde.dataset import Windows, load_dataset
from nfpde.effects import DataScales
from nfpde.gap.fit import Fitter
from nfpde.gap.loud import ASIDE, MODELS, aside, loudness, noise_residuals
from nfpde.gap.noise import floor_of, learn_scatter
from nfpde.gap.replay import Replay
from nfpde.parameters import Parameter, ParameterSpace
from tests.test_gap_directions import CART, SIGMA, rides

HORIZONS = (1, 5, 11)


@pytest.fixture(scope="module")
def rover(tmp_path_factory):
    """A sound rover on two wheels and a caster: its model, windows, noise of its sensors, typical forces."""
    system = draw_system(77, 45, "none")
    assert system.key["robot"] == "rover"
    folder = tmp_path_factory.mktemp("rover")
    write_public(system.xml, system.free, system.robot, system.runs, folder)
    model, noise = mujoco.MjModel.from_xml_path(str(folder / "model.xml")), system.key["noise"]
    space = ParameterSpace([Parameter("body_mass", "chassis", 1.0, 9.0)])
    replay = Replay(model, space, [])
    data = replay.sim.prepare(load_dataset(folder / "data.npz"))
    windows = data.windows(HORIZONS[-1])[::2]
    return replay, windows, np.concatenate([noise["qpos"], noise["qvel"]]), DataScales.of(model, data).force


def lead(replay: Replay, windows: Windows, noise: np.ndarray, at: int, places: np.ndarray) -> float:
    """Nats by which the first place is likelier than the second, in noise that was drawn beside one of them."""
    left = Fitter(windows, HORIZONS).residuals_at(replay, places)
    floor = floor_of(left[0], Fitter(windows, HORIZONS).moved(replay))
    quiet = loudness(noise, left[at], floor).quieten(left)
    first, second = (float(learn_scatter(r, 0, floor).log_density(r).sum()) for r in quiet)
    return first - second


def test_noise_beside_models_pushed_aside_does_not_favour_its_own(rover):
    """Drawn beside the model that made the recordings, or beside one whose mass is off: it must tell the same.

    What touches what hangs on a hair, and windows that are quiet beside one model alone speak against all others.
    """
    replay, windows, sigma, force = rover
    own = replay.sim.nominal()[: replay.nfree]
    off = own.copy()
    off[0] *= 1.1
    places = np.stack([own, off])

    def favours(force: np.ndarray | None) -> tuple[float, float]:
        """Nats for its own by the noise of the one, beyond those by the noise of the other; and the mean of both."""
        leads = [
            lead(replay, windows, noise_residuals(replay, xi, windows, HORIZONS, sigma, 0, 12, force), at, places)
            for at, xi in enumerate(places)
        ]
        return leads[0] - leads[1], float(np.mean(leads))

    (alone, _), (pushed, told) = favours(None), favours(force)
    assert alone > 100.0
    assert abs(pushed) < alone / 3.0
    assert told > 10.0 * abs(pushed)


def test_a_model_is_pushed_by_a_share_of_typical_forces():
    """The same pushes whatever is asked, none where none are wanted, and a motion that is smooth does not mind."""
    force = np.array([1.0, 20.0, 300.0])
    pushes = aside(force, 3)
    assert pushes.shape == (MODELS, 3)
    # the root mean square of so few errs by a third
    assert np.sqrt((pushes**2).mean(0)) == pytest.approx(ASIDE * force, rel=0.8)
    np.testing.assert_array_equal(aside(2 * force, 3, 2), 2 * pushes[:2])
    np.testing.assert_array_equal(aside(None, 3), np.zeros((1, 3)))
    free = CART.replace('type="plane"', 'type="plane" contype="0" conaffinity="0"').replace(
        "<option ", '<option gravity="0 0 0" '
    )
    replay, windows = Replay(mujoco.MjModel.from_xml_string(free), None, []), rides().windows(5)[::40]
    plain, pushed = (
        noise_residuals(replay, np.zeros(0), windows, (1, 5), SIGMA, 0, 8, force)
        for force in (None, np.array([1.0, 1.0, 0.1, 0.1]))
    )
    np.testing.assert_allclose(pushed, plain, atol=0.05 * np.abs(plain).max())
