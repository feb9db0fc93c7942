"""Arrays in one block of memory: what is there is what was put there, and the oldest go first."""

import numpy as np
import pytest

from nfpde.gap.shelf import Shelf


def test_what_is_held_is_what_was_put_and_the_newest():
    """Of arrays of any size, put there at random."""
    rng, most = np.random.default_rng(0), 100
    shelf, put = Shelf(most), dict[int, np.ndarray]()
    for name in range(2000):
        shape = (101,) if name % 10 == 9 else tuple(rng.integers(1, 6, size=rng.integers(1, 3)))
        put[name] = rng.normal(size=shape)
        shelf.put(name, put[name])
        held = [n for n in put if shelf.get(n) is not None]
        for n in held:
            np.testing.assert_array_equal(shelf.get(n), put[n])
        fits = put[name].size <= most
        assert (name in held) is fits
        # of what was held before only the oldest went
        expected = [n for n in put if n >= held[0] and put[n].size <= most]
        assert held == expected
        # free are its end, too short for what began anew, and what is left of the last that made room, 25 at most each
        assert sum(put[n].size for n in held) > most - 50 or held[0] == 0


@pytest.mark.parametrize("size", [0, 101])
def test_what_does_not_fit_leaves_all_as_it_was(size):
    shelf = Shelf(100)
    shelf.put("first", np.ones(60))
    shelf.put("second", np.zeros(size))
    assert shelf.get("second") is None
    np.testing.assert_array_equal(shelf.get("first"), np.ones(60))


def test_it_can_be_full_to_the_last_number():
    shelf = Shelf(100)
    for name in range(10):
        shelf.put(name, np.full(10, float(name)))
    assert all((shelf.get(name) == name).all() for name in range(10))
    shelf.put(10, np.full(10, 10.0))
    assert shelf.get(0) is None
    assert all((shelf.get(name) == name).all() for name in range(1, 11))
