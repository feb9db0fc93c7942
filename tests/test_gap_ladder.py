"""The ladder where there is nothing to climb: models that reproduce their recordings to the last digit."""

import json
import re

import pytest

from nfpde.gap import Level, diagnose_gap, write_report
from nfpde.gap.html_causes import scale
from nfpde.gap.html_svg import percent
from nfpde.gap.report import Distance, Fitted
from nfpde.gap.words import _first, summary
from nfpde.parameters import Parameter, ParameterSpace
from tests.gap_systems import nominal, record

NO_DISTANCE = Distance(0.0, 0.0, 0.0, 0.0, 60)


def numbers(value):
    """All numbers of a JSON value."""
    if isinstance(value, dict):
        return [n for v in value.values() for n in numbers(v)]
    return [value]


@pytest.mark.parametrize("free", [False, True])
def test_a_model_that_is_right_has_a_ladder_without_senseless_ratios(free, tmp_path):
    """Nothing is divided by a gap of nothing: the ladder counts in what rounding may do, and words say so."""
    space = ParameterSpace([Parameter("body_mass", "fore", 0.7, 1.6)]) if free else None
    found = diagnose_gap(nominal(), record(episodes=4, rows=150), space, nthread=1, device="cpu")
    assert found.verdict == "no_gap"
    assert found.gap.before < 1
    assert found.summary == ["The model reproduces the recordings to rounding: there is no gap to explain."]
    gap = json.loads(found.save(tmp_path).read_text())["gap"]
    assert all(0 <= n < 2 for n in numbers({k: gap[k] for k in gap if k != "distance"}))
    assert [value for _, value in found.ladder] == [found.gap.before, found.gap.after_parameters, found.gap.noise_floor]
    assert "relative to what rounding may do" in write_report(found, tmp_path).read_text()


def test_what_parameters_shrink_is_told_where_there_was_something():
    """A share of a gap that is no more than rounding is none."""
    mass = {"mass": Fitted(1.0, 0.9, 1.1, "kg")}
    plain, nothing = (Level(before, 0.001, 0.001, 0.01) for before in (1.0, 0.5))
    said = [summary("no_gap", gap, [], [], mass, None, NO_DISTANCE, 0.1) for gap in (plain, nothing)]
    assert any("shrinks the gap by 99.9%" in line for line in said[0])
    assert not any("shrinks" in line for line in said[1])


def test_a_mere_number_has_no_unit_behind_it():
    """A friction's coefficient is 0.8, not "0.8 -"."""
    said = [
        summary(
            "no_gap",
            Level(1.0, 1.0, 1.0, 1.0),
            [],
            [],
            {"it": Fitted(0.8, 0.7, 0.9, unit, True)},
            None,
            NO_DISTANCE,
            0.1,
        )
        for unit in ("-", "", "Nm")
    ]
    assert [re.findall(r"\(.*\)", line)[0] for _, line in said] == ["(0.8)", "(0.8)", "(0.8 Nm)"]


@pytest.mark.parametrize(
    ("value", "words"), [(10.0, "1000%"), (99.99, "9999%"), (100.0, "1.0e+04%"), (1e300, "1.0e+302%"), (1e308, "–")]
)
def test_percentages_of_any_size_are_short(value, words):
    """What is many times the whole is a power of ten."""
    assert percent(value) == words
    assert len(_first("effects", Level(1.0, 1.0, 0.1, value), (0, ""))) < 100


def test_a_floor_decades_above_the_nominal_model_sets_no_scale():
    """The rungs below it would be told apart by nothing."""
    low, high = scale([1.0, 0.3, 1e12])
    assert high == 1.0
    assert low > -2
