"""The face of a certificate, its Methods text, and its tables."""

import base64
import csv
import io
import re

import pytest

import trabecula as tb
from trabecula.report import page
from trabecula.report.provenance import face, today


@pytest.fixture(scope="module")
def certificate():
    exemplar = tb.crop(tb.sample("bone"), 64)
    made = tb.method("noise", reach=6, octaves=2).fit(exemplar).generate(32, seed=11)
    return tb.verify(exemplar, made, names=["made.zarr"], level="quick", r_max=8)


def test_the_face_names_exemplar_hash_date_version_method_and_settings(certificate):
    first, second, third = face(certificate, date="2031-05-06")
    digest = certificate.about["exemplar"]["recipe"][-1]["sha256"]
    size = "64 x 64 x 64 voxels of 40 um, phases void, solid"
    assert first == f"Exemplar: sample:bone, {size} (SHA-256 {digest[:12]}...)."
    assert "made by the method noise of trabecula" in second and "with seed 11" in second
    # what is as usual is not said
    assert second.endswith("and the settings octaves 2, reach 6.")
    assert third == f"Judged on 2031-05-06 by trabecula {tb.__version__} at the quick level."


def test_what_is_done_afterwards_is_said(certificate):
    image = dict(certificate.about["image"])
    image["recipe"] = [*image["recipe"], {"verb": "finish", "operation": "connect", "sha256": "ab"}]
    other = type(certificate)(certificate.metrics, name="x", about={"image": image})
    assert "then finished by connect." in face(other, date="d")[0]
    image["recipe"] = []
    assert "whose making is not recorded." in face(other, date="d")[0]


def test_the_methods_text_cites_the_software_and_the_paper(certificate):
    text = certificate.methods_text(date="2031-05-06")
    digest = certificate.about["image"]["recipe"][-1]["sha256"]
    assert digest in text and "on 2031-05-06" in text and "99 % of other samples" in text
    assert re.search(r"^\[1\] trabecula", text, re.M) and re.search(
        r"^\[2\] Quiblier \(1984\)", text, re.M
    )
    verdict = {"pass": "made.zarr passed", "fail": "made.zarr failed"}
    assert verdict.get(certificate.verdict, "made.zarr was not decided") in text


def test_tables_have_every_figure_and_curve(certificate, tmp_path):
    certificate.to_csv(tmp_path / "f.csv")
    rows = list(csv.DictReader((tmp_path / "f.csv").open(encoding="utf-8")))
    assert [row["figure"] for row in rows] == list(certificate.metrics)
    curves = list(csv.DictReader(io.StringIO(certificate.to_csv(curves=True))))
    for who in ("exemplar", "image"):
        radial = [float(r["value"]) for r in curves if (r["of"], r["curve"]) == (who, "two_point")]
        assert radial == pytest.approx(list(certificate.curves[who]["two_point"]))
    assert "part 8" in {row["of"] for row in curves}


def test_the_page_holds_face_text_and_tables(certificate):
    html = page([certificate], date="2031-05-06")
    assert "Judged on 2031-05-06" in html and "For a Methods section" in html
    links = dict(re.findall(r'download="([\w.]+)" href="data:text/csv;base64,([^"]+)"', html))
    assert set(links) == {"figures.csv", "curves.csv"}
    assert base64.b64decode(links["figures.csv"]).decode() == certificate.to_csv()


def test_the_date_can_be_fixed(monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "86400")
    assert today() == "1970-01-02"
    monkeypatch.delenv("SOURCE_DATE_EPOCH")
    assert re.fullmatch(r"20\d\d-\d\d-\d\d", today())
