"""`--effort`: settings chosen by trial, from the command line and from Python."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.cli.main import main, whole_parser
from trabecula.cli.method_choice import _others
from trabecula.errors import InputError
from trabecula.pipeline import trials as choosing
from trabecula.report.certificate import Certificate
from trabecula.report.metrics import Metric


@pytest.fixture
def bone():
    return tb.crop(tb.sample("bone"), 32)


def judge(monkeypatch, outside):
    """Let the certificate find so many figures out of band in each trial."""

    def verdicts(exemplar, *images):
        assert [image.shape for image in images] == [exemplar.shape] * len(outside)
        return [
            Certificate(
                {f"figure {number}": Metric(1.0, passed=number >= count) for number in range(5)}
            )
            for count in outside
        ]

    monkeypatch.setattr(choosing, "verify", verdicts)


@pytest.mark.whole
def test_the_trial_with_the_fewest_figures_out_of_band_is_taken(bone, monkeypatch):
    judge(monkeypatch, [3, 1, 2])
    chosen, made = tb.choose_settings(tb.method("texture", tries=1), bone)
    assert [dict(trial.settings) for trial in made] == [
        {},
        {"search": "leaves"},
        {"layout": "structure"},
    ]
    assert [len(trial.outside) for trial in made] == [3, 1, 2]
    assert chosen.config == tb.method("texture", tries=1, search="leaves").config
    assert str(made[1]) == "search=leaves: 1 of 5 figures out of band: figure 0"


@pytest.mark.whole
def test_of_equals_the_settings_as_they_are_stay_and_what_was_set_is_not_tried(bone, monkeypatch):
    judge(monkeypatch, [1, 1])
    asked = tb.method("texture", search="leaves", sweeps=1)
    chosen, made = tb.choose_settings(asked, bone)
    assert chosen.config == asked.config
    assert [dict(trial.settings) for trial in made] == [{}, {"layout": "structure"}]
    for settings in ({"preset": "fast"}, {"layout": "structure"}):  # leaves would change nothing
        offered = tb.method("texture", **settings).config.alternatives(3)
        assert offered and not any("search" in one for one in offered)


@pytest.mark.slow
def test_another_method_is_tried_beside_the_settings(bone, monkeypatch):
    judge(monkeypatch, [3, 2, 3, 1])
    asked = tb.method("texture", tries=1)
    chosen, made = tb.choose_settings(asked, bone, others=[tb.method("noise")])
    assert chosen.capabilities.name == "noise"
    assert str(made[3]) == "method=noise: 1 of 5 figures out of band: figure 0"
    judge(monkeypatch, [1, 2])
    chosen, made = tb.choose_settings(tb.method("noise"), bone, others=[tb.method("texture")])
    assert chosen.capabilities.name == "noise"
    assert len(made) == 2
    none_left = tb.method("texture", novelty=0.2, layout="coarse")
    _, made = tb.choose_settings(none_left, bone, effort=3, others=[tb.method("noise")])
    assert [dict(trial.settings) for trial in made] == [{}, {"method": "noise"}]


def test_methods_that_cannot_make_the_request_are_not_tried(bone):
    def others(*words):
        options = whole_parser().parse_args(["generate", "bone.tif", "--out", "x.tif", *words])
        shape = None if options.shape is None else [int(side) for side in options.shape]
        found = _others(tb.method("texture"), bone, options, shape)
        return [one.capabilities.name for one in found]

    assert others("--shape", "64") == ["packing", "fibres"]
    assert others("--fixed", "bone.tif", "--shape", "64", "64", "80") == ["packing"]
    assert others("--shape", "64", "--target", "porosity=0.8") == []
    assert others("--shape", "2000", "2000", "2000", "--memory", "1") == []


@pytest.mark.whole
def test_of_equally_many_figures_out_of_band_the_nearer_material_is_taken(bone, monkeypatch):
    def verdicts(exemplar, *images):
        found = []
        for value in (1.3, 1.1, 9.0):
            figures = {
                "thickness": Metric(value, (0.8, 1.5), passed=True, exemplar=1.0),
                "percolates": Metric([True] * 3, passed=True),
                "euler": Metric(float("inf"), (0.0, 1.0), passed=True, exemplar=0.0),
            }
            found.append(Certificate(figures))
        return found

    monkeypatch.setattr(choosing, "verify", verdicts)
    chosen, made = tb.choose_settings(tb.method("texture", tries=1), bone)
    assert [round(trial.apart, 6) for trial in made] == [0.6, 0.2, 3.0]
    assert chosen.config.search == "leaves"
    assert str(made[1]).endswith("0 of 3 figures out of band; all 0.20 of their bands off")


@pytest.mark.whole
def test_a_method_that_cannot_learn_is_left_out_with_a_line(bone, monkeypatch):
    judge(monkeypatch, [1])
    told = []
    with tb.progress(lambda label, fraction: told.append(label)):
        chosen, made = tb.choose_settings(
            tb.method("noise"), bone, others=[tb.method("packing"), tb.method("kopf")]
        )
    assert chosen.capabilities.name == "noise"
    assert len(made) == 1
    assert any("packing is not tried: the exemplar has fewer than 8" in line for line in told)
    assert any("kopf is not tried" in line for line in told)


def test_effort_1_tries_nothing(bone):
    asked = tb.method("texture")
    assert tb.choose_settings(asked, bone, effort=1) == (asked, ())


@pytest.mark.parametrize(
    ("method", "settings", "effort", "said"),
    [
        ("quilt", {}, 2, "no alternatives"),
        ("texture", {"novelty": 0.2, "layout": "coarse"}, 3, "nothing is left"),
        ("texture", {}, 4, "effort=4"),
    ],
)
def test_what_cannot_be_tried_is_refused(bone, method, settings, effort, said):
    with pytest.raises(InputError, match=said):
        tb.choose_settings(tb.method(method, **settings), bone, effort=effort)


@pytest.mark.whole
def test_the_command_line_tells_every_trial_and_records_the_settings(tmp_path, bone, capsys):
    scan, out = tmp_path / "bone.tif", tmp_path / "new.tif"
    tb.write(bone, scan)
    asked = ["generate", str(scan), "--method", "texture", "--shape", "32", "--seed", "3"]
    assert main([*asked, "--effort", "2", "--out", str(out)]) == 0
    told = capsys.readouterr()
    lines = [line for line in told.err.splitlines() if "figures out of band" in line]
    assert len(lines) == 3
    counts = [int(line.split(": ")[2].split(" of ")[0]) for line in lines]
    recorded = tb.read(out).recipe.steps[-1]["settings"]
    taken = ({}, {"search": "leaves"}, {"layout": "structure"})[int(np.argmin(counts))]
    assert all(recorded[name] == value for name, value in taken.items())
    again = tb.method("texture", **taken).fit(tb.read(scan)).generate(32, seed=3)
    assert np.array_equal(tb.read(out).values, again.values)


@pytest.mark.whole
def test_effort_beside_a_model_or_without_an_exemplar_is_refused(tmp_path, bone, capsys):
    out, model = str(tmp_path / "x.tif"), tmp_path / "bone.model"
    tb.method("texture", preset="fast").fit(bone).save(model)
    asked = ["generate", "--shape", "32", "--effort", "2", "--out", out]
    assert main([*asked, "--model", str(model)]) == 2
    assert "--effort beside --model" in capsys.readouterr().err
    assert main([*asked, "--method", "noise"]) == 2
    assert "one exemplar" in capsys.readouterr().err
