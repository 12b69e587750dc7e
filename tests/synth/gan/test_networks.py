"""The networks: what a voxel depends on, and the paper's table of layers."""

import pytest

torch = pytest.importorskip("torch", reason="method gan needs the extra 'learn'")

from trabecula.errors import InputError  # noqa: E402
from trabecula.synth.gan.config import PRESETS, GanConfig  # noqa: E402
from trabecula.synth.gan.networks import (  # noqa: E402
    blur,
    new_discriminator,
    new_generator,
)
from trabecula.synth.gan.rearranged import depth_to_space, space_to_depth  # noqa: E402

GENERATORS = {
    "subpixel": GanConfig(width=4, latent=3),
    "subpixel, raw": GanConfig(width=4, latent=3, smoothing=0),
    "subpixel, smooth": GanConfig(width=4, latent=3, smoothing=1, polish=1),
    "B": GanConfig(generator="deconvolution", width=2, latent=3),
    "A": GanConfig(generator="deconvolution+conv", width=2, latent=3),
}


@pytest.fixture(params=sorted(GENERATORS))
def network(request):
    with torch.random.fork_rng():
        torch.manual_seed(1)
        network = new_generator(GENERATORS[request.param], 2).eval()
        for layer in network.modules():  # so that signals come through, as after a training
            if isinstance(layer, (torch.nn.Conv3d, torch.nn.ConvTranspose3d)):
                torch.nn.init.normal_(layer.weight, 0, 0.2)
            elif isinstance(layer, torch.nn.BatchNorm3d):
                layer.running_var.uniform_(0.5, 1.5)
        return network


def latent(network, *cells):
    draw = torch.Generator().manual_seed(7)
    inputs = network.latent + network.fractions
    return torch.randn(1, inputs, *(side + 2 * network.halo for side in cells), generator=draw)


def test_cells_have_the_promised_size(network):
    with torch.inference_mode():
        assert network.cells(latent(network, 1, 2, 3)).shape == (
            1,
            2,
            *(network.cell * side for side in (1, 2, 3)),
        )


def test_a_voxel_does_not_know_where_its_tile_ends(network):
    """Parts of a latent, halo and all, give the same voxels as the whole, but for the order of
    sums, which is the processor's and may depend on the size.
    """
    z, edge, halo = latent(network, 3, 3, 2), network.cell, network.halo
    with torch.inference_mode():
        whole = network.cells(z)
        for first in (0, 1, 2):
            part = network.cells(z[:, :, first : first + 1 + 2 * halo])
            torch.testing.assert_close(
                part, whole[:, :, first * edge : (first + 1) * edge], rtol=1e-5, atol=1e-5
            )


def test_a_latent_reaches_no_farther_than_the_halo(network):
    """A cell of the latent changes its own voxels, and none farther away than the halo."""
    z, edge, halo = latent(network, 5, 1, 1), network.cell, network.halo
    with torch.inference_mode():
        before = network.cells(z)
        for cell in (0, halo, halo + 2, 4 + 2 * halo):
            other = z.clone()
            other[:, :, cell] = -3
            changed = (network.cells(other) != before).flatten(3).any(-1)[0].any(0)
            reached = torch.nonzero(changed).flatten() // edge + halo  # in cells of the latent
            assert (
                (reached - cell).abs().max() <= halo if len(reached) else cell in (0, 4 + 2 * halo)
            )
            assert not halo <= cell < 5 + halo or bool((reached == cell).any())


def test_doubling_and_halving_undo_each_other():
    x = torch.arange(2 * 16 * 27, dtype=torch.float32).reshape(2, 16, 3, 3, 3)
    assert depth_to_space(x).shape == (2, 2, 6, 6, 6)
    assert torch.equal(space_to_depth(depth_to_space(x)), x)


def test_no_chequerboard_passes_the_blur():
    axes = torch.meshgrid(*(torch.arange(8),) * 3, indexing="ij")
    board = (-1.0) ** (axes[0] + axes[1] + axes[2])
    stripes = (-1.0) ** axes[1]
    for pattern in (board, stripes):
        assert torch.equal(blur(pattern[None, None] + 2), torch.full((1, 1, 6, 6, 6), 2.0))


@pytest.mark.parametrize(
    ("reading", "maps"),
    [
        (
            "deconvolution+conv",
            [(100, 512), (512, 512), (512, 256), (256, 128), (128, 64), (64, 1)],
        ),
        ("deconvolution", [(100, 512), (512, 512), (512, 256), (256, 128), (128, 1)]),
    ],
)
def test_the_papers_generator(reading, maps):
    with torch.device("meta"):
        network = new_generator(GanConfig(**{**PRESETS["paper"], "generator": reading}), 1)
        layers = [
            m
            for m in network.modules()
            if isinstance(m, (torch.nn.ConvTranspose3d, torch.nn.Conv3d))
        ]
        assert [(layer.in_channels, layer.out_channels) for layer in layers] == maps
        assert all(layer.kernel_size == (4, 4, 4) for layer in layers[:5])
        assert network(torch.empty(1, 100, 1, 1, 1)).shape == (1, 1, 64, 64, 64)


def test_the_papers_discriminator():
    with torch.device("meta"):
        discriminator = new_discriminator(GanConfig(**PRESETS["paper"]), 1)
        layers = [m for m in discriminator.modules() if isinstance(m, torch.nn.Conv3d)]
        assert [layer.out_channels for layer in layers[:5]] == [64, 128, 256, 512, 512]
        crop = torch.empty(3, 1, 64, 64, 64)
        assert [part.shape for part in discriminator(crop)] == [(3, 1, 1, 1, 1)]
        assert [part.shape[1:] for part in discriminator.features(crop)] == [
            (64, *(32,) * 3),
            (128, *(16,) * 3),
            (256, *(8,) * 3),
        ]
        patches = new_discriminator(GanConfig(**PRESETS["patchgan"]), 1)
        assert [part.shape for part in patches(crop)] == [(3, 1, 2, 2, 2)]


@pytest.mark.parametrize("crop", [40, 48, 64])
def test_the_judge_of_two_scales_takes_the_crops_that_the_config_allows(crop):
    config = GanConfig(crop=crop, width=2)
    discriminator = new_discriminator(config, 1)
    near, far = discriminator(torch.zeros(2, 1, crop, crop, crop))
    assert near.shape[0] == far.shape[0] == 2
    assert near[0].numel() >= 1
    assert far[0].numel() >= 1


def test_polish_comes_after_the_training():
    """Two blurs as it becomes material, one as the discriminator sees it."""
    networks = [
        new_generator(GanConfig(width=2, latent=2, smoothing=1, polish=polish), 1)
        for polish in (0, 1)
    ]
    networks[1].load_state_dict(networks[0].state_dict())
    z = latent(networks[0], 1, 1, 1)
    with torch.inference_mode():
        assert torch.equal(networks[0](z), networks[1](z))
        assert torch.equal(networks[0](z), networks[0].cells(z))
        assert networks[1].cells(z).std() < networks[1](z).std()
    with pytest.raises(InputError, match="polish"):
        GanConfig(smoothing=2, polish=1)


def test_crops_that_no_network_takes_are_refused():
    for settings in (
        {"crop": 32},
        {"crop": 44},
        {**PRESETS["paper"], "crop": 48},
        {**PRESETS["paper"], "crop": 32},
    ):
        with pytest.raises(InputError, match="crop"):
            GanConfig(**settings)
