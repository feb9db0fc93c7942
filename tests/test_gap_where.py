"""The forces that a model lacks, window by window, where single windows tell nothing."""

import re
from types import SimpleNamespace
from typing import Any

import numpy as np

from nfpde.gap.html_curves import residual_force
from nfpde.gap.noise import learn_scatter
from nfpde.gap.report import ResidualForce
from nfpde.gap.where import needed_forces

COUNT, LOST = 60, 17


class Seen:
    """Windows of one degree of freedom that lack 0.3 Nm, one of which diverges whatever acts."""

    def __init__(self, noise):
        self.noise, self.gain = noise, np.random.default_rng(1).uniform(0.5, 1.5, (COUNT, 1, 6))

    def residuals_at(self, replay, xi, force):
        found = np.stack([-(0.3 - f[0]) * self.gain + self.noise for f in force])
        found[:, LOST] = np.nan
        return found


def lacking():
    """The forces and where they were found."""
    noise = 0.01 * np.random.default_rng(0).normal(size=(400, 1, 6))
    quiet = learn_scatter(noise, 0, 1e-4 * np.ones((1, 6)))
    fit: Any = SimpleNamespace(replay=SimpleNamespace(nv=1), xi=np.zeros(0))
    seen: Any = Seen(noise[:COUNT])
    return needed_forces(fit, seen, quiet, np.ones(1), noise)


def test_a_window_that_diverges_tells_nothing_of_the_force():
    """Its error is infinite and it explains nothing; all others tell the force to within their errors."""
    found, others = lacking(), np.arange(COUNT) != LOST
    assert found.value[LOST] == found.energy[LOST] == 0.0
    assert np.isinf(found.error[LOST])
    # noise of 0.01 in six channels that answer by 0.5 at least, four standard deviations
    np.testing.assert_allclose(found.value[others], 0.3, atol=4 * 0.01 / (0.5 * np.sqrt(6)))
    assert (found.energy[others] > 0).all()


def test_windows_that_tell_little_set_no_axis():
    """Neither one without any answer nor one with a wide error flattens what the others show."""
    found, at = lacking(), np.linspace(-1, 1, COUNT)
    error = found.error[:, 0].copy()
    error[3] = 1e6
    page = residual_force(ResidualForce("j", "Nm", 0.5, at, at, at, found.value[:, 0], error))
    marks = [float(x) for x in re.findall(r'class="end">(-?[\d.e+]+)</text>', page)]
    assert marks
    assert max(map(abs, marks)) < 1
    assert page.count("<circle") == 3 * (COUNT - 1)
