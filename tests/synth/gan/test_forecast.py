"""Forecasts of a training: its arithmetic, the memory of a GPU, and the arithmetic's precision. No
GPU is needed: what one says of itself is put in its place.
"""

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="method gan needs the extra 'learn'")

import trabecula as tb  # noqa: E402
from trabecula.errors import MemoryBudgetError  # noqa: E402
from trabecula.synth.gan import forecast  # noqa: E402
from trabecula.synth.gan.config import PRESETS, GanConfig  # noqa: E402
from trabecula.synth.gan.networks import (  # noqa: E402
    Deconvolution,
    arithmetic,
    training_arithmetic,
)

CARD = torch.device("cuda", 0)
IMAGE = tb.Image(np.arange(64**3).reshape(64, 64, 64).astype(np.uint8) % 2, "labels")
PAPER = GanConfig(**PRESETS["paper"])


@pytest.fixture
def card(monkeypatch):
    """A card with 80 GiB free, of compute capability 9."""
    there = {"free": 80 << 30, "capability": (9, 0)}
    monkeypatch.setattr(
        torch.cuda, "mem_get_info", lambda *_: (there["free"], there["free"]), raising=False
    )
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda *_: there["capability"])
    return there


@pytest.mark.parametrize(
    ("last", "layers"),
    [
        # inputs x outputs x 4^3 x places of the smaller side, from the paper's table
        (False, (512 * 100 * 1, 512 * 512 * 64, 512 * 256 * 512, 256 * 128 * 4096, 128 * 32768)),
        (True, (51200, 512 * 512 * 64, 512 * 256 * 512, 256 * 128 * 4096, 128 * 64 * 32768)),
    ],
)
def test_the_arithmetic_of_the_papers_generator(last, layers):
    reading = "deconvolution+conv" if last else "deconvolution"
    config = replace(PAPER, generator=reading, batch=1, structural=0.0, gram=0.0)
    with torch.device("meta"):
        generator, z, _, _ = forecast._networks(config, 1, flat=False)
        found = sum(forecast._layer_flops(generator, lambda: generator(z)))
    output = 2 * 64 * 27 * 64**3 if last else 0
    assert found == 2 * 64 * sum(layers) + output


def test_the_whole_iteration_of_the_paper_in_both_readings():
    """About 16 and 27 TFLOP: what the forecast of hours is made of."""
    assert forecast.iteration_flops(PAPER) == pytest.approx(16.4e12, rel=0.15)
    other = forecast.iteration_flops(replace(PAPER, generator="deconvolution+conv"))
    assert other == pytest.approx(26.8e12, rel=0.15)


def test_a_card_that_is_too_small_is_told_before_the_training_with_the_batch_that_fits(card):
    forecast.check_device_memory(PAPER, [IMAGE], CARD)
    card["free"] = 8 << 30
    with pytest.raises(MemoryBudgetError, match=r"8\.\d? ?GiB are free: set batch=(\d+)") as told:
        forecast.check_device_memory(PAPER, [IMAGE], CARD)
    batch = int(str(told.value).rpartition("batch=")[2])
    assert 0 < batch < 100
    forecast.check_device_memory(replace(PAPER, batch=batch), [IMAGE], CARD)
    with pytest.raises(MemoryBudgetError):
        forecast.check_device_memory(replace(PAPER, batch=batch + 1), [IMAGE], CARD)
    card["free"] = 1 << 30
    with pytest.raises(MemoryBudgetError, match="smaller width"):
        forecast.check_device_memory(PAPER, [IMAGE], CARD)


def test_the_process_is_not_charged_for_the_cards_memory(card):
    on_card = forecast.training_bytes(PAPER, [IMAGE], CARD)
    host = forecast.host_bytes(PAPER, [IMAGE], CARD)
    assert "results of layers" in on_card and "results of layers" not in host
    assert sum(host.values()) < sum(on_card.values()) / 2 and sum(host.values()) < 6 << 30


def test_the_device_that_trains_decides_on_bf16_and_an_explicit_precision_is_obeyed(card):
    auto, cpu = GanConfig(), torch.device("cpu")
    assert training_arithmetic(auto, CARD) == arithmetic(auto, CARD) == "bf16"
    card["capability"] = (7, 0)
    assert training_arithmetic(auto, CARD) == "float32"
    for precision in ("bf16", "float32"):
        for device in (CARD, cpu):
            assert training_arithmetic(GanConfig(precision=precision), device) == precision


@pytest.mark.parametrize("last", [False, True])
def test_cells_are_the_middle_of_the_whole_whatever_is_left_out(last):
    """Each layer makes only what the next one needs: the same voxels as without."""
    torch.manual_seed(0)
    network = Deconvolution(3, 2, 1, last=last).eval()
    z = torch.randn(1, 3, 7, 8, 7)
    with torch.inference_mode():
        whole, cells = network(z), network.cells(z)
    wanted = whole[:, :, 64:80, 64:96, 64:80]
    assert cells.shape == wanted.shape
    assert torch.allclose(cells, wanted, rtol=1e-4, atol=1e-3 * float(wanted.std()))
