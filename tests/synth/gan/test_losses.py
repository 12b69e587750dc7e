"""The losses against known values and naive oracles."""

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="method gan needs the extra 'learn'")

from trabecula.synth.gan import losses  # noqa: E402
from trabecula.synth.gan.config import GanConfig  # noqa: E402
from trabecula.synth.gan.losses import (  # noqa: E402
    EDGES,
    SLICES,
    CandidateTable,
    cubes_of,
    gram,
    squared_distances,
)
from trabecula.synth.gan.networks import new_discriminator  # noqa: E402


def volume(seed, *shape):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def test_the_standard_loss_is_the_cross_entropy_of_the_sigmoid():
    verdicts = volume(1, 4, 1, 2, 2, 2)
    for real in (True, False):
        wanted = torch.nn.functional.binary_cross_entropy(
            torch.sigmoid(verdicts), torch.full_like(verdicts, float(real))
        )
        assert float(losses.standard([verdicts], real=real)) == pytest.approx(
            float(wanted), rel=1e-5
        )


def test_the_relativistic_loss_counts_differences_alone():
    a, b = volume(1, 2, 1, 3, 3, 3), volume(2, 2, 1, 3, 3, 3)
    assert float(losses.relativistic([a, a], [a, a])) == pytest.approx(2 * np.log(2), rel=1e-6)
    assert float(losses.relativistic([a + 5], [b + 5])) == pytest.approx(
        float(losses.relativistic([a], [b])), rel=1e-5
    )
    assert losses.relativistic([a + 1], [b]) < losses.relativistic([a], [b])


def test_the_gradient_penalty_of_a_linear_judge_is_the_square_of_its_weights():
    class Linear(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.weights = torch.nn.Parameter(volume(3, 1, 1, 4, 4, 4))

        def forward(self, x):
            return [(x * self.weights).sum((1, 2, 3, 4), keepdim=True)]

    discriminator = Linear()
    penalty = losses.gradient_penalty(discriminator, volume(4, 5, 1, 4, 4, 4))
    assert float(penalty.detach()) == pytest.approx(
        float(discriminator.weights.detach().square().sum()), rel=1e-5
    )
    penalty.backward()
    assert torch.allclose(discriminator.weights.grad, 2 * discriminator.weights, rtol=1e-5)


def test_sliced_is_zero_for_the_same_and_grows_with_the_difference():
    x = volume(5, 1, 1, 32, 32, 32)

    def distance(y):
        return float(losses.sliced(y, x, torch.Generator().manual_seed(0)))

    assert distance(x) == 0
    assert 0 < distance(1.1 * x) < distance(1.5 * x)


def test_sliced_of_two_white_noises_is_that_of_two_gaussians():
    """The squared distance of N(0, 1) and N(0, 9) is 4 along every direction."""
    a, b = volume(6, 1, 1, 64, 64, 64), 3 * volume(7, 1, 1, 64, 64, 64)
    found = float(losses.sliced(a, b, torch.Generator().manual_seed(0), scales=1))
    assert found == pytest.approx(4, rel=0.1)


def test_gram_against_its_definition():
    fake, real = volume(8, 2, 3, 8, 8, 8), volume(9, 2, 3, 8, 8, 8)

    def naive(features):
        found = []
        for axis in range(3):
            for number in range(SLICES):
                at = number * 8 // SLICES + 8 // (2 * SLICES)
                found.append(
                    np.einsum("bmyx,bnyx->bmn", *[features.numpy().take(at, axis + 2)] * 2) / 64
                )
        return np.stack(found, 1)

    wanted = np.square(naive(fake) - naive(real)).mean()
    assert float(gram([fake], [real])) == pytest.approx(float(wanted), rel=1e-5)
    assert float(gram([fake], [fake])) == 0


def test_regions_are_the_cubes_of_the_features():
    features = volume(10, 2, 3, 4, 6, 9)  # the last voxel along x is left over
    cubes = cubes_of(features, 2)
    assert cubes.shape == (2 * 2 * 3 * 4, 3 * 8)
    assert torch.equal(
        cubes[2 * 3 * 4 + 1 * 12 + 2 * 4 + 3].reshape(3, 2, 2, 2), features[1, :, 2:4, 4:6, 6:8]
    )


def test_squared_distances():
    a, b = volume(11, 5, 7), volume(12, 4, 7)
    assert np.allclose(squared_distances(a, b), torch.cdist(a, b).square(), atol=1e-4)


@pytest.fixture(scope="module")
def discriminator():
    with torch.random.fork_rng():
        torch.manual_seed(2)
        # Each crop on its own, or features would depend on which crops are in a chunk.
        return new_discriminator(
            GanConfig(generator="subpixel", discriminator="score", crop=32, width=2), 1
        ).eval()


@pytest.mark.parametrize("chunk", [1, 2, 5])
def test_the_structural_loss_finds_the_nearest_region_whatever_the_chunks(discriminator, chunk):
    fake, real = volume(13, 2, 1, 32, 32, 32), volume(14, 5, 1, 32, 32, 32)
    with torch.no_grad():
        features, candidates = discriminator.features(fake), discriminator.features(real)
        wanted = 0.0
        for layer, edge in enumerate(EDGES):
            asked, offered = (
                cubes_of(features[layer], edge).numpy(),
                cubes_of(candidates[layer], edge).numpy(),
            )
            apart = np.square(asked[:, None] - offered[None]).sum(2)
            wanted += np.square(asked - offered[apart.argmin(1)]).mean()
        assert float(
            CandidateTable(real, chunk=chunk).loss(discriminator, features)
        ) == pytest.approx(float(wanted), rel=1e-4)
        assert float(
            CandidateTable(fake, chunk=chunk).loss(discriminator, features)
        ) == pytest.approx(0, abs=1e-8)


def test_the_structural_loss_pulls_towards_the_exemplar(discriminator):
    fake, real = volume(15, 1, 1, 32, 32, 32).requires_grad_(True), volume(16, 3, 1, 32, 32, 32)
    table = CandidateTable(real, chunk=2)
    before = table.loss(discriminator, discriminator.features(fake))
    before.backward()
    with torch.no_grad():
        step = 0.1 * fake.norm() / fake.grad.norm()
        after = table.loss(discriminator, discriminator.features(fake - step * fake.grad))
    assert float(after) < 0.95 * float(before.detach())
