"""The bench with two coupled loops, studies, a campaign, kept verdicts and FRFs of others beside it."""

from functools import partial
from unittest import mock

import bench
import numpy as np
from bench import said_by

from loopshape.toolbox.campaign import parallel

LOOP = """
[[loop]]
name = "{0}"
reference = "r_{0}_m"
control = "z_{0}_v"
output = "y_{0}_m"
controller = [{{ kind = "gain", gain = 2.0 }}]
"""
COLUMNS = "\n".join(
    f'{kind}_{name}_{unit} = {{ from = "{kind}_{name}", unit = "{unit[0].upper() if unit == "v" else unit}" }}'
    for name in "ab"
    for kind, unit in (("r", "m"), ("z", "v"), ("y", "m"))
)
RECORDING = """
[recording]
name = "of_{0}"
kind = "multisine"
excites = "{0}"
injection = "reference"
period_s = 2.0
periodic_from_s = 2.0
"""
HEAD = f'format = "loopshape-map/1"\nrate_hz = 200.0\n[columns]\n{COLUMNS}\n'
LIMITS = '[[loop]]\nname = "{0}"\nintegrators = 0\nunstable_poles = 0\nsensitivity_peak_db = 9.0\n'
SEVERAL = 'format = "loopshape-requirements/1"\n' + "".join(LIMITS.format(name) for name in "ab")
CONTROLLERS = 'format = "loopshape-controllers/1"\nrate_hz = 200.0\n' + "".join(
    f'[[loop]]\nname = "{name}"\ncontroller = [{{ kind = "gain", gain = 2.0 }}]\n' for name in "ab"
)
STUDY = """
format = "loopshape-study/1"
rig = "simulated"
plant = "servo-axis"
seed = {seed}
operating_points = [{{ position_m = 0.0 }}]
[[experiment]]
name = "sines"
excites = "position"
[experiment.excitation]
kind = "multisine"
f_low_hz = 2.0
f_high_hz = 20.0
period_s = 1.0
periods = 2
ramp_s = 0.2
amplitude_mm = 0.1
"""
CAMPAIGN = 'format = "loopshape-campaign/1"\nstudy = "study.toml"\ndraws = {draws}\nseed = 1\n'


def prepare(folder):
    """The bench's files, and those of the commands here."""
    bench.prepare(folder)
    for at, name in enumerate("ab"):
        (folder / f"of_{name}.csv").write_text(recorded(at))
        (folder / f"of_{name}.toml").write_text(HEAD + LOOP.format("a") + LOOP.format("b") + RECORDING.format(name))
        made(folder, "import", folder / f"of_{name}.csv", "--map", folder / f"of_{name}.toml", "--out", folder / "two")
    made(folder, "frf", folder / "two", "--matrix", "--no-figures")
    (folder / "again.toml").write_text((folder / "of_a.toml").read_text().replace('name = "of_a"', 'name = "again"'))
    (folder / "several.toml").write_text(SEVERAL)
    (folder / "both.toml").write_text(CONTROLLERS)
    (folder / "study.toml").write_text(STUDY.format(seed=1))
    (folder / "other_study.toml").write_text(STUDY.format(seed=2))
    for draws, name in enumerate(("one_draw", "campaign", "more_draws"), start=1):
        (folder / f"{name}.toml").write_text(CAMPAIGN.format(draws=draws))
    with mock.patch.object(parallel, "by_processes", bench.one_by_one):
        made(folder, "campaign", folder / "one_draw.toml", "--out", folder / "many", "--quiet")
        for part in ("1/2", "2/2"):
            made(folder, "campaign", folder / "campaign.toml", "--out", folder / "parts", "--quiet", "--part", part)
    for kind in ("csv", "mat", "uff"):
        made(folder, "export", folder / "run", "--to", kind, "--out", folder / "given")
    made(folder, *commands(folder)["check --save-verdict"])
    return folder


def made(folder, *words):
    """What must be done before others can be."""
    code, _, err = said_by(words).split("\0")
    assert code in "01", (words, err)


def recorded(excited):
    """Text of a recording of two coupled axes, one of them excited: five periods of a multisine as its reference."""
    k, lines, rng = np.arange(400), np.arange(1, 80), np.random.default_rng(5 + excited)
    phases = rng.uniform(0.0, 2.0 * np.pi, lines.size)
    sines = np.tile(np.cos(2.0 * np.pi * np.outer(k, lines) / k.size + phases).sum(axis=1) / 20.0, 5)
    plant, y, rows = 0.305 * np.array([[1.0, 0.2], [-0.1, 0.8]]), np.zeros(2), ["r_a,r_b,z_a,z_b,y_a,y_b"]
    for now, noise in zip(sines, 1e-3 * rng.normal(size=(sines.size, 2)), strict=True):
        r = np.where(np.arange(2) == excited, now, 0.0)
        z = 2.0 * (r - y - noise)
        rows.append(",".join(f"{value:.17g}" for value in (*r, *z, *(y + noise))))
        y = 0.939 * y + plant @ z
    return "\n".join(rows) + "\n"


def commands(folder):
    """Words of the bench's commands and of these."""
    run, two, out, machine = folder / "run", folder / "two", partial(folder.joinpath), folder / "many" / "d000000-x1"
    study, require, controller = folder / "study.toml", folder / "require.toml", folder / "controller.toml"
    several = (two, "--require", out("several.toml"), "--no-figures")
    simulated = ("--out", out("simulated"))
    frf = ("import-frf", "--out", out("theirs"), "--rate-hz", "200", "--loop", "axis")
    return bench.commands(folder) | {
        "frf --matrix": ("frf", two, "--matrix", "--no-figures"),
        "import a third": ("import", out("of_a.csv"), "--map", out("again.toml"), "--out", two),
        "measure": ("measure", study, "--out", out("measured"), "--quiet"),
        "measure otherwise": ("measure", out("other_study.toml"), "--out", out("measured"), "--quiet"),
        "simulate": ("simulate", study, *simulated, "--json"),
        "simulate otherwise": ("simulate", study, *simulated, "--effect", "loop_delay=1", "--json"),
        "campaign": ("campaign", out("campaign.toml"), "--out", out("many"), "--quiet"),
        "campaign of more": ("campaign", out("more_draws.toml"), "--out", out("many"), "--quiet"),
        "campaign --part": ("campaign", out("campaign.toml"), "--out", out("parts"), "--quiet", "--part", "2/2"),
        "campaign --merge": ("campaign", out("campaign.toml"), "--out", out("parts"), "--quiet", "--merge"),
        "import into a machine": ("import", out("a.csv"), "--map", out("other.toml"), "--out", machine, "--replace"),
        "frf of a machine": ("frf", machine, "--no-figures"),
        "figures of a machine": ("figures", machine),
        "verify a machine": ("verify", machine, "--json"),
        "import-frf": (*frf, out("given", "a.axis.csv"), "--recording", "theirs", "--json"),
        "import-frf --replace": (*frf, out("given", "a.axis.mat"), "--recording", "theirs", "--replace", "--json"),
        "import-frf of two": (*frf, out("given", "a.axis.uff"), "--recording", "third", "--relative-std", "0.01"),
        "interaction": ("interaction", two, "--no-figures", "--json"),
        "check --matrix": ("check", *several[:1], out("both.toml"), *several[1:], "--json"),
        "check --matrix --junit": ("check", two, out("both.toml"), *several[1:], "--junit", out("several.xml")),
        "check --save-verdict": (
            "check", run, controller, "--require", require, "--no-figures", "--junit", out("junit.xml"),
            "--markdown", out("verdict.md"), "--save-verdict", out("verdict.json"),
        ),
        "check --baseline": (
            "check", run, controller, "--require", require, "--no-figures", "--json", "--baseline", out("verdict.json")
        ),
        "export-controller": ("export-controller", controller, "--to", "c", "--out", out("controller_c")),
        "export-excitation": ("export-excitation", study, "--to", "csv", "--out", out("signals")),
    }  # fmt: skip
