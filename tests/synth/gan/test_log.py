"""What a training leaves in its folder."""

import csv

import numpy as np
from PIL import Image as Picture

from trabecula.synth.gan.log import TrainingLog, as_bytes, plot_losses


def row(iteration, maker):
    return {"iteration": iteration, "minutes": iteration / 60, "generator": maker, "distance": 1.0}


def test_a_slice_is_stretched_from_black_to_white():
    assert np.array_equal(as_bytes(np.array([[0, 1], [2, 1]])), [[0, 128], [255, 128]])
    assert np.array_equal(as_bytes(np.full((2, 2), 7)), np.zeros((2, 2)))


def test_metrics_are_complete_where_figures_come_later(tmp_path):
    folder = TrainingLog(str(tmp_path))
    folder.add(row(1, 0.5), np.eye(4))
    folder.add({**row(2, 0.25), "gram": 3.0}, np.eye(4))
    found = list(csv.DictReader((tmp_path / "metrics.csv").open()))
    assert [line["generator"] for line in found] == ["0.5", "0.25"]
    assert [line["gram"] for line in found] == ["", "3.0"]
    assert np.array_equal(np.asarray(Picture.open(tmp_path / "slice-000002.png")), 255 * np.eye(4))


def test_a_run_that_goes_on_keeps_what_was_there(tmp_path):
    first = TrainingLog(str(tmp_path))
    first.add(row(1, 0.5), np.eye(4))
    again = TrainingLog(str(tmp_path))
    again.restore(first.rows)
    again.add(row(2, 0.25), np.eye(4))
    assert [line["iteration"] for line in csv.DictReader((tmp_path / "metrics.csv").open())] == [
        "1",
        "2",
    ]
    assert np.array_equal(again.slices[0], first.slices[0])


def test_the_curve_falls_where_the_loss_does():
    rows = [row(i, 1 - i / 20) for i in range(11)]
    canvas = np.asarray(plot_losses(rows, [np.zeros((4, 4), np.uint8)] * 11)).astype(int)
    blue = np.abs(canvas - (31, 119, 180)).sum(-1) == 0
    blue[-60:] = False  # the name of the curve
    heights = [np.flatnonzero(blue[:, x]).mean() for x in (100, 500, 900)]
    assert heights[0] < heights[1] < heights[2]
    assert np.allclose(np.diff(heights), np.diff(heights).mean(), rtol=0.05)


def test_without_a_folder_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    TrainingLog("").add(row(1, 0.5), np.eye(4))
    assert list(tmp_path.iterdir()) == []
