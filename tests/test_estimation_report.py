"""The fit's report: one file that needs nothing else, names escaped, everything the fit found in it."""

from html.parser import HTMLParser
from io import BytesIO

import matplotlib.image
import numpy as np
import pytest
import torch

import nfpde
from nfpde.estimation import write_report
from nfpde.flow import build_flow

torch.set_num_threads(1)
DT = 0.1
NAMES = ["<b>gain</b>", "drift & $lag_1$", "idle"]
SPACE = nfpde.ParameterSpace([nfpde.Parameter(name, low=-5.0, high=5.0) for name in NAMES])


def step(x, u, xi):
    """The third parameter does nothing."""
    return x + DT * (xi[:, :1] * u + xi[:, 1:2])


class Reader(HTMLParser):
    """Collects text, tags and addresses; complains about tags that do not close."""

    def __init__(self):
        super().__init__()
        self.text, self.tags, self.sources, self.open = [], [], [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.sources += [v for k, v in attrs if k in ("src", "href")]
        if tag not in ("img", "meta", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def fitted(drift):
    """A fit of four robots that lose `drift` a second."""
    rng = np.random.default_rng(0)
    episodes = []
    for i in range(4):
        u = rng.normal(size=(30, 1))
        x = np.concatenate([[[0.0]], np.cumsum(DT * ((1 + 0.3 * i) * u[:-1] - drift), axis=0)])
        x += 0.001 * rng.normal(size=x.shape)
        episodes.append(nfpde.Episode(f"robot <{i}>", DT * np.arange(30), x, np.empty((30, 0)), u))
    return nfpde.fit(nfpde.CallableSimulator(step, SPACE, ["x"]), nfpde.Dataset(episodes), quiet=True)


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """The report of a fit of four robots, read: their drift lies below its bounds."""
    result = fitted(5.3)
    folder = tmp_path_factory.mktemp("report")
    files = write_report(result, folder)
    assert {p.name for p in files} == {"report.html", "report.png"}
    page = (folder / "report.html").read_text(encoding="utf-8")
    reader = Reader()
    reader.feed(page)
    return result, folder, page, reader


def test_opens_offline(report):
    """No script, style sheet, font or picture comes from elsewhere; the file is whole and below 8 MB."""
    _, _, page, reader = report
    assert reader.open == []
    assert reader.sources
    assert all(s.startswith("data:image/png;base64,") for s in reader.sources)
    assert not {"script", "link", "iframe"} & set(reader.tags)
    assert "http" not in page
    assert "url(" not in page
    assert len(page) < 8e6


def test_names_are_escaped(report):
    """Names with signs of HTML and of formulas are shown as they are."""
    _, _, _, reader = report
    text = " ".join(reader.text)
    assert all(name in text for name in NAMES)
    assert "robot <3>" in text
    assert reader.tags.count("b") == 1, "the chosen population's name, and no parameter's"


def test_holds_what_the_fit_found(report):
    """Words of every parameter, bounds that robots lean on, advice, candidates and errors."""
    result, _, _, reader = report
    text = " ".join(reader.text)
    info = result.info
    assert all(row["words"] in text for row in info["tells"]["parameters"].values())
    assert "not told by these recordings" in text
    assert "on the low one" in text
    assert all(row["words"] in text for row in info["record_next"])
    assert info["population"]["chosen"] in text
    for row in info["residuals"].values():
        assert f"{row['before']:.3g}" in text
        assert f"{row['after']:.3g}" in text
    assert f"{info['population']['held_out']:.2f}" in text


def test_a_value_near_its_bound_does_not_lean_on_it(report):
    """At -4.95 with an error of 0.001 the bound of -5 cuts nothing off; what lies beyond it does lean."""
    beside = fitted(4.95).info["robots"]
    assert [r["parameters"][NAMES[1]]["leans_on"] for r in beside] == [None] * 4
    assert [r["parameters"][NAMES[1]]["leans_on"] for r in report[0].info["robots"]] == ["low"] * 4


def test_picture(report):
    """A PNG with something drawn on it, and the same one inside the page."""
    _, folder, _, _ = report
    image = matplotlib.image.imread(BytesIO((folder / "report.png").read_bytes()))
    assert min(image.shape[:2]) > 300
    assert 0.001 < (image[..., :3] < 0.9).any(2).mean() < 0.9


def test_a_report_of_another_method_is_refused(tmp_path):
    """Only the method trajectory finds what the report shows."""
    density = build_flow(3)
    distribution = nfpde.ParameterDistribution(SPACE, density)
    other = nfpde.FitResult(distribution, distribution, [], {"method": "softmax"})
    with pytest.raises(nfpde.NfpdeError, match="a fit by the method softmax has no report; trajectory has"):
        write_report(other, tmp_path)
