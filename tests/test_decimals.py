"""Numbers as precisely as they are known."""

import math

import pytest

from nfpde.decimals import places_of, rounded
from nfpde.estimation.report.numbers import with_std


@pytest.mark.parametrize(
    ("error", "places"), [(0.0123, 3), (0.1, 2), (0.099, 3), (1.0, 1), (7.7, 1), (980.0, -1), (1.1e-9, 10)]
)
def test_places_reach_the_second_digit_of_an_error(error, places):
    """Rounding an error there changes it by a twentieth at most."""
    assert places_of(error) == places
    assert abs(round(error, places) - error) <= 0.05 * error


@pytest.mark.parametrize(
    ("value", "places", "written"),
    [
        (0.6, 4, "0.6000"),
        (-0.004, 2, "0"),
        (0.996, 2, "1.00"),
        (5123.4, -2, "5100"),
        (999_999.6, 0, "1.000000e+06"),
        (3.2e7, -5, "3.20e+07"),
        (2.34e-6, 8, "2.34e-06"),
        (0.00012, 5, "0.00012"),
    ],
)
def test_numbers_are_rounded_with_their_zeros(value, places, written):
    """And read back to what was rounded."""
    assert rounded(value, places) == written
    assert float(written) == pytest.approx(round(value, places), abs=0)


@pytest.mark.parametrize(
    ("value", "std", "written"),
    [
        (3.3, 0.772, "3.30 ± 0.77"),
        (5123.4, 980.0, "5120 ± 980"),
        (4.66123456789, 1.11e-9, "4.661235 ± 1.1e-09"),
        (0.0, 0.25, "0 ± 0.25"),
        (1e-18, 0.25, "0 ± 0.25"),
        (1.5, 0.0, "1.5 ± 0"),
        (1.5, math.nan, "1.5 ± unknown"),
    ],
)
def test_values_go_with_their_standard_deviations(value, std, written):
    """A value that is known better than anyone reads has seven digits."""
    assert with_std(value, std) == written
