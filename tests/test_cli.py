"""The command line: the whole pipeline in a folder, help, errors in one line, Ctrl-C."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from unittest import mock

import matplotlib.image
import numpy as np
import pytest

from nfpde.dataset import load_dataset
from nfpde.distribution import ParameterDistribution
from nfpde.estimation import FitResult
from nfpde.parameters import Parameter, ParameterSpace
from nfpde.truth import Truth
from tests.command_line import TINY, plain, run
from tests.models import PENDULUM


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Recordings of three Hoppers, a fit and its evaluation."""
    home = tmp_path_factory.mktemp("cli")
    steps = [
        ("collect", "hopper", "--out", home / "data", "--episodes", 3, "--steps", 30, "--target", "mixture"),
        ("fit", "hopper", home / "data", "--out", home / "fit", *TINY),
        ("evaluate", home / "fit", "--truth", home / "data" / "truth.json", "--samples", 50),
    ]
    for arguments in steps:
        status, out, err = run(*arguments)
        assert (status, err) == (0, ""), (arguments[0], err)
        (home / f"{arguments[0]}.txt").write_text(out)
    return home


def test_collect(folder):
    """Recordings, the truth apart from them, and the parameters, each readable by the library."""
    dataset = load_dataset(folder / "data" / "data.npz")
    truth = Truth.load(folder / "data" / "truth.json")
    space = ParameterSpace.from_toml(folder / "data" / "parameters.toml")
    assert len(dataset) == len(truth.xi) == 3
    assert truth.space == space
    assert len(space) == 6
    assert sorted(p.name for p in (folder / "data").iterdir()) == ["data.npz", "parameters.toml", "truth.json"]
    out = (folder / "collect.txt").read_text()
    assert "3 episodes" in out
    assert all(name in out for name in ("data.npz", "truth.json", "parameters.toml"))


def test_fit(folder):
    """The distribution within its bounds, settings as given, both pictures; each file is named in the output."""
    result = FitResult.load(folder / "fit")
    assert result.info["config"]["samples"] == 30
    assert len(result.history) == 3
    space = result.distribution.space
    space.check(ParameterDistribution.load(folder / "fit" / "distribution").sample(10))
    out = (folder / "fit.txt").read_text()
    assert all(name in out for name in ("distribution", "fit.json", "corner.png", "progress.png"))
    assert all(p.name[:12] in out for p in space)


def test_evaluate(folder):
    """Figures in JSON and on the screen; the sentence says what the JSON says."""
    figures = json.loads((folder / "fit" / "evaluation.json").read_text())
    rows = figures["optimal_transport"]["to_episodes"]
    assert set(rows) == {"estimate", "initial", "uniform", "population"}
    assert figures["samples"] == 50
    out = (folder / "evaluate.txt").read_text()
    before, after = rows["initial"]["physical"], rows["estimate"]["physical"]
    assert f"{before:.3g} before the fit, {after:.3g} after it ({after / before:.0%})" in plain(out)
    assert "robots" not in figures, "softmax finds no robots"


def test_evaluate_shows_the_errors_of_robots(tmp_path):
    """Of a fit by trajectories: every robot's, beside its bound, in JSON and on the screen."""
    data, fit = tmp_path / "data", tmp_path / "fit"
    assert run("collect", "pendulum", "--out", data, "--episodes", 2, "--steps", 30)[0] == 0
    assert run("fit", "pendulum", data, "--out", fit, "--method", "trajectory", "--quiet")[0] == 0
    status, out, _ = run("evaluate", fit, "--truth", data / "truth.json", "--samples", 50)
    assert status == 0
    assert "Cramer-Rao" in plain(out)
    found = json.loads((fit / "evaluation.json").read_text())["robots"]
    true = dict(zip(("episode 0", "episode 1"), json.loads((data / "truth.json").read_text())["xi"], strict=True))
    fitted = {row["robot"]: row["parameters"] for row in json.loads((fit / "fit.json").read_text())["robots"]}
    assert found.keys() == fitted.keys() == true.keys()
    for robot, rows in fitted.items():
        for value, (name, row) in zip(true[robot], rows.items(), strict=True):
            assert found[robot][name] == {"error": row["value"] - value, "cramer_rao": row["cramer_rao"]}


def test_evaluate_refuses_the_truth_of_other_recordings(folder, tmp_path):
    """Both files are named; without a hash in either of them there is nothing to compare."""
    truth, others = folder / "data" / "truth.json", tmp_path / "others.json"
    content, fit = json.loads(truth.read_text()), tmp_path / "fit"
    others.write_text(json.dumps({**content, "dataset": "5ca1ab1e" * 8}))
    shutil.copytree(folder / "fit", fit)
    (fit / "evaluation.json").unlink()
    status, out, err = run("evaluate", fit, "--truth", others, "--samples", 20)
    assert (status, out) == (1, "")
    assert f"{others} is not the truth of the recordings of {fit / 'fit.json'}" in err
    assert f"are 5ca1ab1e5ca1... and {content['dataset'][:12]}..." in err
    assert not (fit / "evaluation.json").exists()
    del content["dataset"]
    (tmp_path / "unnamed.json").write_text(json.dumps(content))
    assert run("evaluate", fit, "--truth", tmp_path / "unnamed.json", "--samples", 20)[0] == 0
    (fit / "fit.json").unlink()
    assert run("evaluate", fit, "--truth", others, "--samples", 20)[0] == 0


@pytest.mark.parametrize("robots", [3, [1], [{"robot": "a"}, None], "abc", {"a": 1}])
def test_evaluate_refuses_a_damaged_fit(folder, tmp_path, robots):
    """What is said of robots in another form is one line with the file; nothing is written."""
    fit, truth = tmp_path / "fit", folder / "data" / "truth.json"
    shutil.copytree(folder / "fit", fit)
    (fit / "evaluation.json").unlink()
    (fit / "fit.json").write_text(json.dumps({"schema_version": 1, "robots": robots}))
    status, out, err = run("evaluate", fit, "--truth", truth, "--samples", 20)
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert f"nfpde: {fit / 'fit.json'}: the entry 'robots' is not what nfpde fit writes" in err
    assert not (fit / "evaluation.json").exists()


@pytest.mark.parametrize("name", ["corner.png", "progress.png", "evaluation.png"])
def test_pictures(folder, name):
    """Readable PNGs of a size for a screen, with something drawn on them."""
    image = matplotlib.image.imread(folder / "fit" / name)
    height, width = image.shape[:2]
    assert 400 <= width <= 4000
    assert 400 <= height <= 4000
    colours = (image[..., :3] * 255).astype(int) @ [1 << 16, 1 << 8, 1]
    assert len(np.unique(colours)) > 20
    assert 0.001 < (image[..., :3] < 0.9).any(2).mean() < 0.9


def test_the_same_fit_again_is_read_back(folder):
    """The same command on a finished folder gives the same table, from the same samples."""
    before = (folder / "fit" / "fit.json").read_bytes()
    status, out, err = run("fit", "hopper", folder / "data", "--out", folder / "fit", *TINY)
    assert (status, err) == (0, "")
    assert out == (folder / "fit.txt").read_text()
    assert (folder / "fit" / "fit.json").read_bytes() == before


def test_a_model_of_ones_own(folder, tmp_path):
    """A model file with parameters in TOML, and recordings as CSV."""
    (tmp_path / "pendulum.xml").write_text(PENDULUM)
    (tmp_path / "unknown.toml").write_text(
        '[[parameter]]\nfield = "body_mass"\ntarget = "rod"\nlow = 0.5\nhigh = 3\n'
        '[[parameter]]\nfield = "dof_damping"\ntarget = "hinge"\nlow = 0.01\nhigh = 0.5\n'
    )
    rows = ["episode,time,qpos_hinge,qvel_hinge,ctrl_motor"]
    rows += [f"a,{0.01 * i:.3f},{np.cos(0.1 * i):.6f},{-np.sin(0.1 * i):.6f},0.1" for i in range(20)]
    (tmp_path / "log.csv").write_text("\n".join(rows))
    arguments = ("--params", tmp_path / "unknown.toml", "--out", tmp_path / "fit", *TINY)
    status, out, err = run("fit", tmp_path / "pendulum.xml", tmp_path / "log.csv", *arguments)
    assert (status, err) == (0, "")
    assert "dof_damping" in out
    assert FitResult.load(tmp_path / "fit").info["transitions"] == 19


def test_a_folder_of_recordings_is_read_whole(folder, tmp_path):
    """A file called data.npz beside others does not stand for all of them."""
    for name in ("data.npz", "more.npz"):
        (tmp_path / name).write_bytes((folder / "data" / "data.npz").read_bytes())
    assert run("fit", "hopper", tmp_path, "--out", tmp_path / "fit", *TINY)[0] == 0
    both, one = (FitResult.load(f / "fit").info["transitions"] for f in (tmp_path, folder))
    assert both == 2 * one


TABLE = '[[parameter]]\nfield = "body_mass"\ntarget = "{target}"\nlow = {low}\nhigh = {high}\n'

BAD = {
    "unknown robot": ("collect ant --out {tmp}/x", "no benchmark robot is called 'ant'; there are: hopper, walker2d"),
    "no episodes": (
        "collect hopper --episodes 0 --out {tmp}/x",
        "steps and robots must be at least 1, got 0",
    ),
    "more robots than episodes": (
        "collect hopper --episodes 2 --robots 3 --out {tmp}/x",
        "3 robots need as many episodes at least, got 2",
    ),
    "negative seed": ("collect hopper --seed -1 --out {tmp}/x", "seed must be at least 0, got -1"),
    "out is a file": ("collect hopper --episodes 1 --steps 2 --out {tmp}/file", "/file: File exists"),
    "no data": ("fit hopper {tmp}/none.npz --out {tmp}/x", "none.npz: the file does not exist"),
    "no recordings": ("fit hopper {tmp}/file --out {tmp}/x", "unknown suffix ''; known are .npz, .csv, .parquet"),
    "damaged recordings": ("fit hopper {tmp}/broken.npz --out {tmp}/x", "broken.npz: the file cannot be read as .npz"),
    "no model": ("fit hooper {data} --out {tmp}/x", "'hooper' is neither a file nor a benchmark robot (hopper, walk"),
    "no parameters": ("fit {tmp}/model.xml {data} --out {tmp}/x", "say with --params which parameters of"),
    "no toml": ("fit hopper {data} --params {tmp}/none.toml --out {tmp}/x", "none.toml: cannot be read"),
    "broken toml": ("fit hopper {data} --params {tmp}/broken.toml --out {tmp}/x", "broken.toml: not valid TOML"),
    "unknown key": ("fit hopper {data} --params {tmp}/key.toml --out {tmp}/x", "parameter 0: unknown key 'lower'"),
    "unknown field": ("fit hopper {data} --params {tmp}/field.toml --out {tmp}/x", "'body_weight' is no real-valued"),
    "target typo": ("fit hopper {data} --params {tmp}/typo.toml --out {tmp}/x", "torso, thigh, leg, foot"),
    "low above high": ("fit hopper {data} --params {tmp}/bounds.toml --out {tmp}/x", "low (5) must be below high (1)"),
    "other robot": ("fit half_cheetah {data} --out {tmp}/x", "nq=6"),
    "no iterations": (
        "fit hopper {data} --out {tmp}/x --method softmax --iterations 0",
        "iterations is 0; it must be an integer of at",
    ),
    "fit with seed": ("fit hopper {data} --out {tmp}/x --seed -1", "seed is -1; it must be an integer from 0 to 92233"),
    "resample": ("fit hopper {data} --out {tmp}/x --resample 0", "resample is 0.0; it must be a positive number"),
    "too long": ("fit hopper {data} --out {tmp}/x --horizon 500", "500"),
    "truth of others": ("evaluate {fit} --truth {tmp}/other.json", "body_mass:foot, dof_damping:thigh_joint"),
    "no truth": ("evaluate {fit} --truth {tmp}/none.json", "none.json cannot be read"),
    "truth is no json": ("evaluate {fit} --truth {tmp}/broken.toml", "broken.toml is not JSON"),
    "no fit": ("evaluate {tmp} --truth {data}/truth.json", "distribution.json cannot be read (No such file or direct"),
    "one sample": ("evaluate {fit} --truth {data}/truth.json --samples 1", "samples must be at least 2, got 1"),
    "no distribution": ("train pendulum --distribution {tmp} --out {tmp}/x", "distribution.json cannot be read"),
    "no environment": ("train nowhere --distribution {fit} --out {tmp}/x", "environment 'nowhere'"),
    "other environment": ("train pendulum --distribution {fit} --out {tmp}/x", "body_mass:torso"),
}


@pytest.fixture(scope="module")
def bad(folder, tmp_path_factory):
    """A folder of things that are wrong."""
    tmp = tmp_path_factory.mktemp("bad")
    (tmp / "file").write_text("nothing")
    (tmp / "broken.npz").write_bytes(b"PK nothing")
    (tmp / "model.xml").write_text(PENDULUM)
    (tmp / "broken.xml").write_text("<mujoco><worldbody><bdy/></worldbody></mujoco>")
    (tmp / "broken.toml").write_text("[[parameter]\n")
    good = TABLE.format(target="torso", low=1, high=5)
    (tmp / "good.toml").write_text(good)
    (tmp / "key.toml").write_text(good.replace("low", "lower"))
    (tmp / "field.toml").write_text(good.replace("body_mass", "body_weight"))
    (tmp / "typo.toml").write_text(TABLE.format(target="torzo", low=1, high=5))
    (tmp / "bounds.toml").write_text(TABLE.format(target="torso", low=5, high=1))
    other = ParameterSpace([Parameter("body_mass", "torso", low=1.0, high=5.0)])
    Truth(other, np.array([[2.0]]), ["0"]).save(tmp / "other.json")
    return {"tmp": tmp, "data": folder / "data", "fit": folder / "fit"}


@pytest.mark.parametrize("name", BAD)
def test_bad_input(bad, name):
    """One clear line on the error stream, exit status 1, nothing written."""
    command, text = BAD[name]
    status, out, err = run(*command.format(**bad).split())
    assert status == 1
    assert out == ""
    assert err.startswith("nfpde: ")
    assert text in err
    assert err.endswith("\n")
    assert err.count("\n") == 1
    assert not (bad["tmp"] / "x").exists()


def test_a_broken_model(bad):
    """MuJoCo's own message, which takes two lines, and where the error is."""
    arguments = ("--params", bad["tmp"] / "good.toml", "--out", bad["tmp"] / "x")
    status, out, err = run("fit", bad["tmp"] / "broken.xml", bad["data"], *arguments)
    assert (status, out) == (1, "")
    assert err.startswith("nfpde: ")
    assert "broken.xml: MuJoCo cannot compile it" in err
    assert "Element 'bdy', line 1" in err


@pytest.mark.parametrize(
    ("command", "text"),
    [
        ("fit hopper {data}", "nfpde: missing option '--out'; nfpde fit --help explains all options"),
        ("fit hopper {data} --out {tmp}/x --method em", "'em' is not one of 'softmax', 'cai'"),
        ("fit hopper {data} --out {tmp}/x --flow glow", "'glow' is not one of 'auto', 'realnvp', 'nsf', 'maf'"),
        ("fit hopper {data} --out {tmp}/x --samples many", "'--samples'"),
        ("fit hopper {data} --out {tmp}/x --sampels 3", "no such option: --sampels"),
        ("collect hopper --out {tmp}/x --target ring", "'ring' is not one of 'gaussian', 'mixture'"),
        ("evaluate {fit} --truth {data}/truth.json --seed -1", "'--seed'"),
        ("bench", "nfpde: missing command; nfpde bench --help explains all options"),
        ("fitt hopper", "no such command 'fitt'"),
    ],
)
def test_bad_options(bad, command, text):
    """What the command's usage rules out: one line with the option and its choices, exit status 2."""
    status, out, err = run(*command.format(**bad).split())
    assert status == 2
    assert out == ""
    assert err.startswith("nfpde: ")
    assert text in err
    assert (err[-1], err.count("\n")) == ("\n", 1)
    assert not (bad["tmp"] / "x").exists()


def test_no_command_at_all():
    """The help, and exit status 2: nothing was done."""
    status, out, err = run()
    assert (status, err) == (2, "")
    assert "collect" in out


@pytest.mark.parametrize("module", ["torch", "typer"])
@pytest.mark.parametrize("way", ["nfpde", "-m"])
def test_ctrl_c_while_everything_is_imported(tmp_path, way, module):
    """One line and exit status 130, however the command is started; the package itself begins with torch."""
    (tmp_path / f"{module}.py").write_text(
        "import os, signal, time\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "os.kill(os.getpid(), signal.SIGINT)\n"
        "time.sleep(60)\n"
    )
    command = [str(Path(sys.executable).parent / "nfpde")] if way == "nfpde" else [sys.executable, "-m", "nfpde"]
    stopped = subprocess.run(
        [*command, "fit", "--help"],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    line = "nfpde: interrupted before it began; give the same command again\n"
    assert (stopped.returncode, stopped.stdout, stopped.stderr) == (130, "", line)


def test_ctrl_c_in_another_program_is_its_own(tmp_path):
    """A program that imports the package is interrupted as always."""
    (tmp_path / "torch.py").write_text("raise KeyboardInterrupt")
    program = "try:\n    import nfpde\nexcept KeyboardInterrupt:\n    print('mine')"
    other = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert (other.returncode, other.stdout, other.stderr) == (0, "mine\n", "")


def test_the_folder_of_another_fit(folder):
    """What differs is named, and the folder stays as it was."""
    before = (folder / "fit" / "fit.json").read_bytes()
    status, out, err = run("fit", "hopper", folder / "data", "--out", folder / "fit", *TINY, "--seed", 9)
    assert (status, out) == (1, "")
    assert err.startswith("nfpde: ")
    assert "seed: saved 0, now 9" in err
    assert "config" not in err
    assert (folder / "fit" / "fit.json").read_bytes() == before


COMMAND = """
import sys
from nfpde.cli import main
sys.modules["nfpde.estimation.run"].CHECKPOINT_SECONDS = 0.0
main()
"""


def test_ctrl_c(folder, tmp_path):
    """An interrupted fit ends with one line that says how to go on; the same command then does."""
    arguments = ["fit", "hopper", str(folder / "data"), "--out", str(tmp_path / "fit"), *TINY, "--iterations", "40"]
    # a shell that started the tests in the background may have told its children to ignore interrupts
    signal.signal(signal.SIGINT, signal.default_int_handler)
    process = subprocess.Popen([sys.executable, "-c", COMMAND, *arguments], stderr=subprocess.PIPE, text=True)
    started = time.monotonic()
    while not (tmp_path / "fit" / "checkpoint" / "state.safetensors").exists():
        assert process.poll() is None
        assert time.monotonic() - started < 120, "no checkpoint in two minutes"
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err.startswith("nfpde: the fit stopped; ")
    assert err.endswith("of 40 iterations, from which the same command goes on\n")
    assert err.count("\n") == 1
    assert not (tmp_path / "fit" / "fit.json").exists()
    done = int(err.split("state after ")[1].split()[0])
    assert 0 < done < 40
    with mock.patch("nfpde.estimation.nfpde.NfpdeTrainer.step", autospec=True, side_effect=KeyboardInterrupt):
        status, _, err = run(*arguments)
    assert (status, err.count("\n")) == (130, 1)
    # it went on from where it had stopped
    assert f"state after {done} of 40 iterations" in err
    assert run(*arguments)[0] == 0
    assert [row["iteration"] for row in FitResult.load(tmp_path / "fit").history] == list(range(1, 41))


def test_fit_by_trajectory_is_the_default(folder, tmp_path):
    """Words on every parameter on the screen, the report beside fit.json; settings of other methods are refused."""
    quick = ("--starts", 2, "--rounds", 3, "--draws", 10, "--population-rounds", 1, "--resolution", 1e-6, "--quiet")
    status, out, err = run("fit", "hopper", folder / "data", "--out", tmp_path, *quick)
    assert (status, err) == (0, "")
    result = FitResult.load(tmp_path)
    assert result.info["method"] == "trajectory"
    assert result.info["resolution"] == 1e-6
    assert "What the recordings tell of each robot:" in out
    assert all(row["words"] in out for row in result.info["tells"]["parameters"].values())
    assert all(name in out for name in ("report.html", "report.png"))
    assert (tmp_path / "report.html").is_file()
    for idle, method in (("beta", "trajectory"), ("clip", "softmax")):
        where = ("fit", "hopper", folder / "data", "--out", tmp_path / "x", "--method", method)
        status, _, err = run(*where, f"--{idle}", 0.1)
        assert status == 1
        assert f"--{idle} is no setting of the method {method}" in err
