"""By how much the noise of the sensors is misjudged beside contacts."""

import numpy as np
import pytest

from nfpde.dataset import Dataset
from nfpde.gap.brief import brief
from nfpde.gap.erring import MOST, misjudged
from nfpde.gap.recordings import cut_recordings
from nfpde.gap.sensors import sensor_noise
from nfpde.gap.stage import first_fit, in_noise
from tests.test_gap_natural import HISTORY, replay, rests

TRUE = 3e-4 * np.array([1.0, 1.0, 0.1, 0.1])
"""Noise of the recordings of a block at rest [m, m/s]."""


def found(data: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """The noise that is found, and by how much it is misjudged."""
    cut = cut_recordings(data, HISTORY, 0, 160)
    sigma = sensor_noise(replay(), np.zeros(0), cut.rows, cut.encoders)
    return sigma, misjudged(replay(), np.zeros(0), cut.longest, cut.encoders, sigma, 0)


def test_what_a_floor_hides_of_the_noise_is_made_up_for():
    """A height that is measured wrong presses or does nothing: that much is known of its noise is too little.

    In four recordings each noise is found to 2 to 5 %.
    """
    pairs = [found(rests(3e-4, seed)) for seed in range(4)]
    plain = np.mean([np.log(sigma / TRUE) for sigma, _ in pairs], axis=0)
    made_up = np.mean([np.log(sigma / share / TRUE) for sigma, share in pairs], axis=0)
    assert plain[1] < np.log(0.9)
    np.testing.assert_allclose(made_up, 0.0, atol=0.1)


def test_no_noise_is_not_misjudged():
    """Where none was found there is nothing to make up for; and what is found is believed to a factor."""
    cut = cut_recordings(rests(3e-4), HISTORY, 0, 160)
    np.testing.assert_array_equal(
        misjudged(replay(), np.zeros(0), cut.longest, cut.encoders, np.zeros(4), 0), np.ones(4)
    )
    # a sensor that is as good as none beside one that is bad: the floor makes speed of heights, and hides it
    share = misjudged(replay(), np.zeros(0), cut.longest, cut.encoders, np.array([1e-3, 1e-3, 1e-12, 1e-12]), 0)
    assert np.all((share >= 1 / MOST) & (share <= MOST))
    assert share.max() == MOST


@pytest.mark.parametrize("capped", [True, False])
def test_stages_make_up_for_it_where_contacts_are_and_find_it_out_once(capped: bool, monkeypatch: pytest.MonkeyPatch):
    """The first stage finds it out, later ones take its word; in smooth motion nothing is asked."""
    recordings = brief(cut_recordings(rests(3e-4), HISTORY, 0, 160))[0]
    asked = []

    def half(*args: object) -> np.ndarray:
        asked.append(args)
        return np.full(4, 0.5)

    monkeypatch.setattr("nfpde.gap.stage.misjudged", half)
    base, court = first_fit(replay(), recordings, np.zeros((1, 0)), capped=capped)
    first = in_noise(base, court, recordings, 0)
    plain = sensor_noise(replay(), np.zeros(0), recordings.rows, recordings.encoders)
    np.testing.assert_allclose(first.sigma, plain / 0.5 if capped else plain, rtol=1e-9)
    second = in_noise(base, court, recordings, 0, share=first.misjudged)
    np.testing.assert_allclose(second.sigma, first.sigma, rtol=1e-9)
    assert len(asked) == capped
