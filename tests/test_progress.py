"""What long jobs print."""

import io

from nfpde.progress import progress


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


class Terminal(io.StringIO):
    def isatty(self):
        return True


def run(stream, steps=20, seconds=1.0, **options):
    clock = Clock()
    with progress("Fitting", steps, stream=stream, clock=clock, **options) as report:
        for step in range(options.get("start", 0), steps):
            clock.now += seconds
            report(step + 1, loss=1 / 3, beta="[off]")
    return stream.getvalue()


def test_a_log_gets_one_line_in_ten_seconds():
    """Twenty steps of one second give two lines with the steps, the time left and the figures."""
    assert run(io.StringIO()).splitlines() == [
        "Fitting: 10/20, 0:10 left  loss 0.3333  beta [off]",
        "Fitting: 20/20, 0:00 left  loss 0.3333  beta [off]",
    ]


def test_a_short_job_leaves_no_line_in_a_log():
    """Nine seconds are too short for a line."""
    assert run(io.StringIO(), steps=9) == ""


def test_the_time_left_of_a_job_that_goes_on_counts_its_own_steps():
    """90 steps were there before: ten seconds for ten of the last hundred leave 90 seconds, and hours show as hours."""
    lines = run(io.StringIO(), steps=190, start=90).splitlines()
    assert lines[0].startswith("Fitting: 100/190, 1:30 left")
    assert run(io.StringIO(), steps=361, seconds=10.0).startswith("Fitting: 1/361, 1:00:00 left")


def test_quiet_prints_nothing(monkeypatch):
    """Neither a log nor a terminal gets anything."""
    monkeypatch.setenv("TERM", "xterm")
    assert run(io.StringIO(), quiet=True) == ""
    assert run(Terminal(), quiet=True) == ""


def test_a_terminal_gets_a_bar_with_the_figures(monkeypatch):
    """The last frame shows the description, all steps and the figures as they are, brackets too."""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.delenv("NO_COLOR", raising=False)
    text = run(Terminal())
    for part in ("Fitting", "20/20", "loss 0.3333", "beta [off]"):
        assert part in text


def test_the_default_stream_is_stderr(capsys):
    """Nothing reaches the output stream."""
    clock = Clock()
    with progress("Fitting", 2, clock=clock) as report:
        clock.now = 11.0
        report(1)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == "Fitting: 1/2, 0:11 left\n"
