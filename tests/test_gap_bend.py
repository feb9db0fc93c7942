"""Two parameters that do the same together make a narrow valley, which bends: fits follow it to its end."""

from typing import Any

import numpy as np
import pytest

import nfpde.gap.fit
from nfpde.estimation.trajectory.student import GAUSSIAN, Student
from nfpde.gap.fit import Fitter
from nfpde.gap.noise import Scatter

NOISE = 1e-5
END = np.array([0.9, 0.5 * 0.9**2])


class Valley:
    """A mass that is free and a share by which an inertia follows: Rosenbrock's valley, over many windows.

    What both do together is known a thousand times as well as what the first does alone.
    """

    nfree, parameters, nv, effects = 2, (), 1, ()

    def inward(self, xi: np.ndarray) -> np.ndarray:
        return np.array(xi)

    outward = inward

    def residuals(self, xi, windows, horizons, force=None):
        across, along = xi[:, 1] - 0.5 * xi[:, 0] ** 2, 1e-3 * (xi[:, 0] - END[0])
        return np.stack([across, along], axis=-1)[:, None, None] * np.ones((1, len(windows), 1, 1))


@pytest.mark.parametrize("looks", [True, False])
def test_a_fit_follows_a_valley_that_bends(looks, monkeypatch):
    """It ends within the errors of the truth; by straight steps alone it would stop on the way."""
    if not looks:
        monkeypatch.setattr(nfpde.gap.fit, "_BENT", np.inf)
    windows: Any = np.zeros(100)
    replay: Any = Valley()
    fitter = Fitter(windows, (1,))
    scatter = Scatter((Student(np.eye(2) / NOISE, GAUSSIAN),), np.full((1, 2), 1e-9))
    fit = fitter.improve(fitter.start(replay, np.array([[0.1, 0.005]]), scatter), 8)
    error = NOISE / 1e-3 / np.sqrt(len(windows))
    assert bool(abs(fit.xi[0] - END[0]) < error) is looks
    assert abs(fit.xi[1] - 0.5 * fit.xi[0] ** 2) < 10 * NOISE
