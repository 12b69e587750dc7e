"""The convolutions as a GPU makes them, beside PyTorch's own on the processor."""

import pytest

torch = pytest.importorskip("torch", reason="method gan needs the extra 'learn'")

from torch.nn.functional import conv3d, conv_transpose3d  # noqa: E402

from trabecula.synth.gan.folded import double, halve  # noqa: E402


def drawn(*shape):
    draw = torch.Generator().manual_seed(len(shape) + sum(shape))
    return torch.randn(*shape, generator=draw, dtype=torch.float64).requires_grad_(True)


@pytest.mark.parametrize("channels", [1, 3, 8, 9])
@pytest.mark.parametrize(
    ("ours", "theirs", "doubles"),
    [(halve, conv3d, False), (double, conv_transpose3d, True)],
    ids=["convolution", "transposed"],
)
def test_result_and_gradients_are_those_of_pytorch(ours, theirs, doubles, channels):
    weight = drawn(2, channels, 4, 4, 4)
    x = drawn(2, 2 if doubles else channels, 4, 6, 8)
    bias = drawn(channels if doubles else 2)
    given = (x, weight, bias)
    expected = theirs(x, weight, bias, stride=2, padding=1)
    found = ours(*given)
    torch.testing.assert_close(found, expected)
    slope = drawn(*expected.shape).detach()
    for mine, other in zip(
        torch.autograd.grad(found, given, slope),
        torch.autograd.grad(expected, given, slope),
        strict=True,
    ):
        torch.testing.assert_close(mine, other)


@pytest.mark.parametrize("doubles", [False, True])
def test_the_gradient_has_a_gradient(doubles):
    """As the penalty on real crops wants it."""
    ours = double if doubles else halve
    given = drawn(1, 2, 2, 2, 4), drawn(2, 2 if not doubles else 9, 4, 4, 4)
    bias = torch.zeros(9 if doubles else 2, dtype=torch.float64)
    assert torch.autograd.gradgradcheck(lambda x, w: ours(x, w, bias), given, fast_mode=True)
