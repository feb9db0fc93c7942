"""The pictures of a diagnosis: what the page holds, that it needs nothing from outside, and how robots are drawn."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
import pytest
from matplotlib.image import imread

from nfpde.gap import GapMap, Level
from nfpde.gap.drawing import project
from nfpde.gap.drawing_layout import lay_out
from nfpde.gap.html_causes import powers, scale
from nfpde.gap.html_report import headline, page, write_report
from nfpde.gap.html_svg import Panel, luminance, percent, shade
from tests.gap_reports import NASTY, SIX_AXES, arm, gap_report, gym_model

VOID = {"meta", "br", "link", "img", "hr"}
VERDICTS = ("effects", "no_gap", "unexplained")


class Page(HTMLParser):
    """Reads a page strictly: every tag that opens must close in order."""

    def __init__(self, source):
        super().__init__()
        self.open, self.tags, self.attributes, self.words = [], [], [], []
        self.feed(source)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] != "style":
            self.words.append(data)

    @property
    def text(self):
        return "".join(self.words)


def models():
    return {
        "arm": arm(),
        "six": mujoco.MjModel.from_xml_string(SIX_AXES),
        "hopper": gym_model("hopper"),
        "humanoid": gym_model("humanoid"),
        "ant": gym_model("ant"),
    }


@pytest.fixture(scope="module")
def robots():
    return models()


@pytest.mark.parametrize("verdict", VERDICTS)
@pytest.mark.parametrize("robot", ["arm", "six", "hopper", "humanoid"])
def test_page_is_sound_and_asks_for_nothing(robots, robot, verdict):
    """Tags nest, no script runs, and nothing refers to another file or machine."""
    source = page(gap_report(robots[robot], verdict))
    found = Page(source)
    assert found.open == []
    assert not {"script", "link", "iframe", "img", "object", "embed"} & set(found.tags)
    assert not {"src", "href", "xlink:href", "onload"} & {name for name, _ in found.attributes}
    assert not re.search(r"https?://|url\(|@import|\bnan\b|\binf\b", source)
    assert len(source) < 1_000_000


def test_page_tells_every_number(robots):
    """Verdict, ladder, causes with intervals and units, the map's window counts, noise and facts are on the page."""
    report = gap_report(robots["arm"], "effects")
    text = Page(page(report)).text
    for line in (
        "comes from coulomb_friction at elbow and actuation_delay.",
        *report.summary,
        *(label for label, _ in report.ladder),
        *(percent(value) for _, value in report.ladder),
        "torque 0.546 Nm (0.530 to 0.563)",
        "delay 0.01600 s (0.01552 to 0.01648) ▲ at its bound",
        "91% (90% to 92%)",
        "36.5 ± 2 nats",
        "stribeck_friction at elbow",
        "<1 min>",
        "nominal model0.432+ parameters0.346+ effects0.0567noise floor0.0123",
        "over 160 held-out windows",
        "in contact",
        "early",
        "body_mass[elbow]",
        "qvel elbow",
        "1, 4, walk & turn",
        "12,345,678",
        "12.3 s",
        "61",
        "seed17",
    ):
        assert line in text


def test_page_says_what_was_taken_out_of_the_recordings(robots):
    """What an encoder at rest errs by has the unit of its joint; where nothing was taken out, nothing is said."""
    report = gap_report(robots["arm"], "effects")
    assert "reads too high" not in Page(page(report)).text
    text = Page(page(replace(report, encoder_error={"elbow": -0.0123}))).text
    assert "joint at restreads too high byelbow-0.0123 rad" in text


def test_unexplained_gap_shows_the_force_left_over(robots):
    """A dot and an error bar for each window against each of three quantities, and no headline of a cause."""
    report = gap_report(robots["humanoid"], "unexplained")
    source = page(report)
    force = source[source.index("The force that is left over") : source.index("Causes, ranked")]
    assert force.count("<circle") == force.count('class="bar') == 3 * 150
    assert "position [rad]" in force
    assert "speed [rad/s]" in force
    assert "77%" in force
    assert headline(report) == "A gap remains at left_elbow that no effect in the library explains."
    assert "The force that is left over" not in page(gap_report(robots["humanoid"], "effects"))


def test_headline_places_what_is_left(robots):
    """Without accepted effects it lies where the gap lies; then where a force is still missing."""
    report = gap_report(robots["arm"], "unexplained")
    assert report.residual_force is not None
    elsewhere = replace(report, residual_force=replace(report.residual_force, joint="shoulder", share=-0.01))
    assert headline(elsewhere).startswith("A gap remains at elbow that")
    assert "next to nothing" in page(elsewhere)
    partly = replace(elsewhere, effects=report.ranking[:1])
    assert headline(partly).startswith("A gap remains at shoulder besides coulomb_friction at elbow that")


def test_no_gap_colours_no_joint(robots):
    """Shares of mere noise would mislead: the joints stay bare and no map is drawn."""
    source = page(gap_report(robots["arm"], "no_gap"))
    assert source.count('class="disc bare"') == 2
    assert 'class="map"' not in source
    assert 'class="map"' in page(gap_report(robots["arm"], "effects"))


def test_names_full_of_markup_are_text():
    """A joint called like a tag opens no tag, and is read as it was written."""
    source = page(gap_report(arm(NASTY), "effects"))
    found = Page(source)
    assert NASTY not in source
    assert f"coulomb_friction at {NASTY}" in found.text
    assert sorted(set(found.tags)) == sorted(set(Page(page(gap_report(arm(), "effects"))).tags))


def test_same_report_same_bytes(robots, tmp_path):
    """Neither the page nor the picture holds a time, an id drawn at random, or an order that varies."""
    for folder in ("a", "deep/b"):
        path = write_report(gap_report(robots["humanoid"], "unexplained"), tmp_path / folder)
        assert path == tmp_path / folder / "report.html"
    for name in ("report.html", "summary.png"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "deep/b" / name).read_bytes()


@pytest.mark.parametrize("verdict", VERDICTS)
def test_summary_picture_is_not_empty(tmp_path, verdict):
    """Ladder on the left and robot on the right both leave ink, for a name that could pass for a formula too."""
    write_report(gap_report(arm("a$_b^{$"), verdict), tmp_path)
    ink = imread(tmp_path / "summary.png")[..., :3].min(2) < 0.9
    half = ink.shape[1] // 2
    assert ink[:, :half].mean() > 0.02
    assert ink[:, half:].mean() > 0.01


def test_report_of_nothing_is_still_a_page(tmp_path):
    """No traces, horizons, causes, parameters or noise, and values that are not finite, leave a page that says so."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body name="stone"><geom size=".1"/></body></worldbody></mujoco>'
    )
    report = replace(
        gap_report(arm(), "unexplained"),
        ladder=[("nominal model", 1.0), ("+ parameters", float("inf")), ("noise floor", 0.0)],
        ranking=[],
        where=[],
        horizons={},
        base={},
        traces=[],
        residual_force=None,
        sensor_noise={},
        held_out_episodes=[],
        gap=Level(1.0, float("nan"), float("inf"), 0.0),
        gap_map=GapMap([], [], np.zeros((0, 0)), np.zeros((0, 0), dtype=np.intp), {}),
        model=model,
    )
    source = write_report(report, tmp_path).read_text()
    assert Page(source).open == []
    for words in ("No candidate was worth a refit", "No parameter was free", "No horizon was compared"):
        assert words in source


def test_prediction_that_blows_up_does_not_flatten_the_trace(robots):
    """A curve that leaves for infinity is cut, and what was measured still fills a good part of the picture."""
    report = gap_report(robots["arm"], "effects")
    trace = report.traces[0]
    wild = trace.before.copy()
    wild[10:] = [1e3, 1e6, 1e9, np.inf, np.nan, *[1e12] * 6]
    source = page(replace(report, traces=[replace(trace, before=wild)]))
    drawn = re.search(
        r'class="line measured" d="(M[^"]*)"', source[source.index("The worst windows") :].split("panels")[1]
    )
    assert drawn
    heights = [float(part.split()[1]) for part in re.split("[ML]", drawn[1])[1:]]
    # four times the measured range stays free on the side where the curve leaves: a fifth of 162 pixels, less the rim
    assert max(heights) - min(heights) > 0.17 * 162


def test_curves_end_where_they_leave_the_picture():
    """Straight to the rim, not along it; back in where they come back; nothing where a value is missing."""
    panel = Panel((0.0, 6.0), (0.0, 10.0), "", "")
    y = np.array([5.0, 15.0, 30.0, 20.0, 0.0, np.nan, 3.0])
    panel.line(np.arange(7.0), y, "before")
    moves = re.findall(r"([ML])([\d.]+) ([\d.]+)", panel.marks[0])
    at = [(pen, (float(a) - panel.across(0)) / (panel.across(1) - panel.across(0)), float(b)) for pen, a, b in moves]
    assert [(pen, pytest.approx(x, abs=0.01)) for pen, x, _ in at] == [("M", 0.0), ("L", 0.5), ("M", 3.5), ("L", 4.0)]
    expected = [panel.upward(v) for v in (5, 10, 10, 0)]
    assert [b for *_, b in at] == pytest.approx(expected, abs=0.1)


def test_planar_robot_is_seen_along_its_hinges(robots):
    """In the picture the links of a planar arm keep their true lengths, as nowhere else."""
    shoulder, elbow = project(robots["arm"]).anchors
    assert np.linalg.norm(elbow - shoulder) == pytest.approx(np.hypot(0.5, 0.3), abs=1e-12)
    assert shoulder[1] - elbow[1] == pytest.approx(0.3, abs=1e-12)


def test_arm_that_moves_level_is_seen_from_above():
    """With all hinges upright the picture is the plan: x to the right, y up."""
    drawn = project(gym_model("reacher"))
    at = dict(zip(drawn.joints, drawn.anchors, strict=True))
    np.testing.assert_allclose(at["joint1"] - at["joint0"], [0.1, 0.0], atol=1e-12)
    assert drawn.ground is None


def test_humanoid_is_seen_from_the_front(robots):
    """Left and right lie apart, the head above the feet, and the floor below them."""
    drawn = project(robots["humanoid"])
    at = dict(zip(drawn.joints, drawn.anchors, strict=True))
    assert abs(at["left_knee"][0] - at["right_knee"][0]) > 0.15
    assert at["left_shoulder1"][1] > at["left_hip_x"][1] > at["left_knee"][1]
    assert drawn.ground is not None
    assert drawn.ground <= min(p[:, 1].min() for p in drawn.outlines)


def test_flat_robot_is_seen_from_above(robots):
    """The four legs of the ant point four ways; from the side two would hide two."""
    drawn = project(robots["ant"])
    at = dict(zip(drawn.joints, drawn.anchors, strict=True))
    ankles = np.array([at[f"ankle_{i}"] for i in (1, 2, 3, 4)])
    apart = np.linalg.norm(ankles[:, None] - ankles[None], axis=2)
    assert apart[np.triu_indices(4, 1)].min() > 0.3


def test_model_without_geoms_is_drawn_as_bones():
    """A body that has only an inertia still shows."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint axis="0 1 0"/><inertial pos="0 0 -.5" mass="1" diaginertia="1 1 1"/>'
        "</body></worldbody></mujoco>"
    )
    drawn = project(model)
    assert np.ptp(np.vstack(drawn.outlines)[:, 1]) == pytest.approx(0.5, abs=1e-12)


@pytest.mark.parametrize("robot", ["arm", "six", "hopper", "humanoid", "ant"])
def test_labels_name_every_joint_and_do_not_overlap(robots, robot):
    """Each joint is named once, lines of a column keep their distance, and all lies inside the picture."""
    drawn = project(robots[robot])
    layout = lay_out(drawn, {name: 1 / (i + 2) for i, name in enumerate(drawn.joints)})
    labels = [label for disc in layout.discs for label in disc.labels]
    assert sorted(label.full.rsplit(" ", 1)[0] for label in labels) == sorted(drawn.joints)
    for left in (True, False):
        lines = sorted(label.y for label in labels if label.left is left)
        assert all(b - a >= 17.9 for a, b in pairwise(lines))
        assert all(0 < y < layout.height for y in lines)
    corners = np.vstack(layout.outlines)
    assert (corners > 0).all()
    assert (corners < [layout.width, layout.height]).all()


def test_largest_share_has_the_largest_and_darkest_disc(robots):
    """Size and colour both follow the share, so that either alone can be read."""
    share = {"shoulder": 0.2, "elbow": 0.8}
    discs = {d.joints: d for d in lay_out(project(robots["arm"]), share).discs}
    assert discs["elbow",].radius > discs["shoulder",].radius
    values = [luminance(shade(t)[0]) for t in np.linspace(0, 1, 21)]
    assert all(a > b for a, b in pairwise(values))


@pytest.mark.parametrize(("colour", "expected"), [("#ffffff", 1.0), ("#000000", 0.0), ("#00ff00", 0.7152)])
def test_luminance_of_known_colours(colour, expected):
    """White is one, black nothing, and pure green its weight in the definition."""
    assert luminance(colour) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("part", np.linspace(0, 1, 21))
def test_ink_on_every_shade_is_readable(part):
    """Contrast of at least 4.5, as the accessibility guidelines of the web (WCAG 2.1) ask for text."""
    low, high = sorted(luminance(c) for c in shade(float(part)))
    assert (high + 0.05) / (low + 0.05) >= 4.5


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (1.0, "100%"),
        (0.9968, "99.7%"),
        (0.834, "83%"),
        (0.0213, "2.1%"),
        (0.00042, "0.042%"),
        (0.0, "0%"),
        (np.nan, "–"),
        (np.inf, "–"),
    ],
)
def test_percentages_read_well(value, words):
    """Two digits that count, none that do not."""
    assert percent(value) == words


@pytest.mark.parametrize("values", [[1.0, 0.5], [1.0, 1e-6, 0.0], [3.0, 0.9], [1.0, np.inf, np.nan], [0.0], []])
def test_scale_holds_every_finite_value(values):
    """Every positive value has a bar of some length, and the axis has a mark on it."""
    low, high = scale(values)
    for v in values:
        if np.isfinite(v) and v > 0:
            assert low < np.log10(v) <= high
    marks = powers(low, high)
    assert marks
    assert all(low <= np.log10(t) <= high + 1e-9 for t in marks)


def test_command_line_finds_the_writer():
    """The package offers `write_report` beside the report itself."""
    import nfpde.gap

    assert nfpde.gap.write_report is write_report
    assert Path(nfpde.gap.__file__).parent == Path(write_report.__code__.co_filename).parent
