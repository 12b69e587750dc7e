"""Volumes above what a page holds: blocks by coverage, boxes of finer voxels, fields."""

import http.client
import threading

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.errors import InputError
from trabecula.engine.lazy_volume import as_slabs
from trabecula.view.page import fitting
from trabecula.view.page.joining import THIN, join_labels, kept_blocks
from trabecula.view.page.server import PageServer


def joined(values, edge=4):
    image = tb.Image(values.astype(np.uint8), "labels")
    return join_labels(as_slabs(image), (edge,) * 3) > 0


@pytest.mark.parametrize("offset", range(4))
def test_a_wall_of_two_voxels_stays_closed_and_is_drawn_once(offset):
    values = np.zeros((32, 32, 32), bool)
    values[:, :, 12 + offset : 14 + offset] = True
    assert (joined(values).sum(axis=2) == 1).all()


@pytest.mark.parametrize("normal", [(1, 0.3, 0.2), (0.9, 0.5, 0.1), (1, 1, 0.3)])
def test_a_tilted_wall_of_two_voxels_hardly_loses_a_column(normal):
    grid = np.mgrid[:64, :64, :64] - 31.5
    distance = np.tensordot(np.array(normal) / np.linalg.norm(normal), grid, 1)
    wall = np.abs(distance) <= 1
    seen = wall.reshape(16, 4, 16, 4, 16, 4).max(axis=(0, 1, 3, 5))
    assert joined(wall).max(axis=0)[seen].mean() > 0.97


def test_blocks_are_drawn_where_half_is_material_and_noise_does_not_fill_up():
    cover = np.array([0, 127, 128, 255], np.uint8).reshape(1, 1, 4)
    assert kept_blocks(cover, (1, 1, 4)).ravel().tolist() == [False, False, True, True]
    noise = np.random.default_rng(0).random((64, 64, 64)) < 0.3
    assert joined(noise).mean() < 0.3


def test_a_block_takes_the_most_frequent_drawn_label():
    values = np.zeros((4, 4, 4), np.uint8)
    values[1:3], values[3] = 1, 2
    image = tb.Image(values, "labels", phases=("void", "a", "b"))
    assert join_labels(as_slabs(image), (4, 4, 4)).item() == 1


def test_blocks_of_thin_walls_are_marked():
    values = np.zeros((16, 16, 16), np.uint8)
    values[:, :, 4:8] = 1
    values[:, :, 13] = 1
    found = join_labels(as_slabs(tb.Image(values, "labels")), (4, 4, 4))
    assert found[2, 2].tolist() == [0, 1, 0, 1 + THIN]


def test_a_box_of_blocks_is_that_part_of_all_blocks():
    values = np.random.default_rng(1).integers(0, 3, (24, 20, 28)).astype(np.uint8)
    volume = as_slabs(tb.Image(values, "labels"))
    whole = join_labels(volume, (2, 2, 2))
    box = ((3, 9), (0, 4), (5, 14))
    np.testing.assert_array_equal(join_labels(volume, (2, 2, 2), box), whole[3:9, 0:4, 5:14])


@pytest.fixture
def large(monkeypatch):
    """A page of blocks of 2 voxels of an image, and the image."""
    monkeypatch.setattr(fitting, "LARGEST", 8**3)
    image = tb.Image(
        np.random.default_rng(2).integers(0, 2, (16, 16, 16)).astype(np.uint8), "labels"
    )
    return tb.view(image), image


def test_only_the_served_page_may_ask_for_finer_voxels(large, tmp_path):
    page, _ = large
    assert "connect-src" not in page.html and '"detail": true' not in page.html
    assert "connect-src 'self'" in page.live.html and '"detail": true' in page.live.html
    assert "connect-src" not in page.save(tmp_path / "a.html").read_text(encoding="utf-8")
    assert tb.view(np.ones((4, 4, 4), bool)).live is None


def test_the_server_sends_finer_voxels_to_who_has_the_page(large):
    import gzip

    page, image = large
    with PageServer(page.live.html, boxes=page.live.boxes) as server:
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()

        def ask(query, **headers):
            connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=10)
            connection.request("GET", f"/box?{query}", headers=headers)
            answer = connection.getresponse()
            return answer.status, answer.read()

        cookie = {"Cookie": f"trabecula-{server.server_port}={server.cookie}"}
        status, body = ask("volume=0&fine=2&low=1,2,3&size=2,3,4", **cookie)
        assert status == 200
        voxels = np.frombuffer(gzip.decompress(body), np.uint8).reshape(4, 6, 8)
        np.testing.assert_array_equal(voxels, image.values[2:6, 4:10, 6:14])
        assert ask("volume=0&fine=2&low=1,2,3&size=2,3,4")[0] == 404
        for query, words in (
            ("volume=0&fine=2&low=1,2&size=2,3,4", b"low=z,y,x"),
            ("volume=0&fine=3&low=0,0,0&size=1,1,1", b"does not divide"),
            ("volume=0&fine=2&low=7,0,0&size=2,1,1", b"outside"),
            ("volume=-1&fine=2&low=0,0,0&size=1,1,1", b"no finer voxels"),
        ):
            status, body = ask(query, **cookie)
            assert status == 400 and words in body
        server.shutdown()


def test_fields_are_held_between_their_percentiles_where_they_are_drawn():
    rng = np.random.default_rng(3)
    drawn = rng.random((8, 8, 8)) < 0.5
    field = np.where(drawn, rng.random((8, 8, 8)), -50.0)
    values, (low, high) = fitting.fit_field(field, drawn, (1, 1, 1))
    assert [low, high] == pytest.approx(np.quantile(field[drawn], [0.01, 0.99]))
    shown = low + values[drawn] / 255 * (high - low)
    np.testing.assert_allclose(shown, field[drawn].clip(low, high), atol=(high - low) / 500)
    flow = np.where(
        drawn, 0.0, rng.random((8, 8, 8))
    )  # of the void: its limits are those of the void
    assert fitting.fit_field(flow, drawn, (1, 1, 1))[1] == pytest.approx(
        np.quantile(flow[~drawn], [0.01, 0.99])
    )
    blocks = fitting.fit_field(field, drawn, (8, 8, 8))[0]
    assert low + blocks.item() / 255 * (high - low) == pytest.approx(field[drawn].mean(), abs=0.01)


@pytest.mark.parametrize(
    ("field", "message"),
    [
        (np.zeros((4, 4, 5)), "field f is grey of shape"),
        (np.ones((4, 4, 4), bool), "labels, not grey"),
    ],
)
def test_a_field_that_fits_no_image_is_refused(field, message):
    with pytest.raises(InputError, match=message):
        tb.view(np.ones((4, 4, 4), bool), fields={"f": field})
