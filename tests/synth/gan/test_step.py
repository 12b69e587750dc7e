"""One step of the training: the loss of each network, written down from the papers' equations, and
the numbers of the presets.
"""

import dataclasses

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="method gan needs the extra 'learn'")

import trabecula as tb  # noqa: E402
from trabecula.synth.gan import losses  # noqa: E402
from trabecula.synth.gan.adversarial import AdversarialPair  # noqa: E402
from trabecula.synth.gan.config import PRESETS, GanConfig  # noqa: E402
from trabecula.synth.gan.crops import exemplar_fields  # noqa: E402
from trabecula.synth.gan.evaluation import TrainingState  # noqa: E402
from trabecula.synth.gan.losses import CandidateTable  # noqa: E402
from trabecula.synth.gan.networks import new_discriminator  # noqa: E402

SMALL = {"width": 2, "latent": 2, "batch": 2, "precision": "float32", "device": "cpu"}


@pytest.fixture(autouse=True)
def one_thread():
    """Threads cost more than they save on networks as small as these."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def draw(seed, *shape):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def step(config, iteration=0, noise=0.0):
    """Return the pair, its crops, and the losses of discriminator and generator in a step that
    moves no weight.
    """
    pair = AdversarialPair(config, 1, torch.device("cpu"))
    with torch.no_grad():  # so that verdicts and features are of the size that a training has
        for parameter in pair.discriminator.parameters():
            parameter.mul_(3)
    real = torch.tanh(draw(1, config.batch, 1, *(config.crop,) * 3))
    if config.structural:
        pair.table = CandidateTable(draw(2, 3, 1, *(config.crop,) * 3), chunk=2)
    found = {}
    pair._step = lambda network, loss: found.update({network: loss.item()})
    pair.train_step(real, torch.Generator().manual_seed(5), iteration, noise)
    with torch.no_grad():
        fake = pair.generate(torch.Generator().manual_seed(5))
    return pair, real, fake, found[1], found[0]


def log_sigmoid(verdicts):
    return -np.logaddexp(0, -verdicts.double().numpy())


def gram_matrices(features):
    """Return the gram matrices of four slices along each axis of (C, Z, Y, X), section 3.3."""
    found = []
    for axis in (1, 2, 3):
        side = features.shape[axis]
        for number in range(4):
            maps = features.take(number * side // 4 + side // 8, axis).reshape(len(features), -1)
            found.append(maps @ maps.T / maps.shape[1])
    return np.array(found)


def regions(features, edge):
    """Return the cubes of (B, C, Z, Y, X) as rows."""
    found = []
    for crop in features:
        for z, y, x in np.ndindex(*(side // edge for side in crop.shape[1:])):
            here = tuple(slice(edge * at, edge * at + edge) for at in (z, y, x))
            found.append(crop[(slice(None), *here)].ravel())
    return np.array(found)


@pytest.mark.parametrize("name", ["3dgan", "gram", "structural", "paper"])
def test_a_step_takes_equations_1_and_2(name):
    """Equation 1, with the generator's part as Goodfellow et al. advise (it maximises log D), and
    equation 2 with its terms as means: adversarial + 0.1 gram + 1 structural.
    """
    config = GanConfig(**{**PRESETS[name], **SMALL, "generator": "subpixel", "crop": 32})
    pair, real, fake, of_discriminator, of_generator = step(config)
    with torch.no_grad():
        on_real, on_fake = pair.discriminator(real)[0], pair.discriminator(fake)[0]
        features, wanted_features, candidates = (
            [part.double().numpy() for part in pair.discriminator.features(crops)]
            for crops in (fake, real, draw(2, 3, 1, 32, 32, 32)[:2])
        )
        last = pair.discriminator.features(draw(2, 3, 1, 32, 32, 32)[2:])
    wanted = -log_sigmoid(on_real).mean() - log_sigmoid(-on_fake).mean()
    assert of_discriminator == pytest.approx(wanted, rel=1e-5)
    wanted = -log_sigmoid(on_fake).mean()
    if name in ("gram", "paper"):
        for made, known in zip(features, wanted_features, strict=True):
            apart = [gram_matrices(a) - gram_matrices(b) for a, b in zip(made, known, strict=True)]
            wanted += 0.1 * np.square(apart).mean()
    if name in ("structural", "paper"):
        for layer, edge in enumerate((8, 4, 2)):
            asked = regions(features[layer], edge)
            parts = candidates[layer], last[layer].double().numpy()
            table = np.concatenate([regions(part, edge) for part in parts])
            nearest = np.square(asked[:, None] - table[None]).sum(2).argmin(1)
            wanted += np.square(asked - table[nearest]).mean()
    assert of_generator == pytest.approx(wanted, rel=1e-4)


def test_the_sums_are_those_that_the_paper_prints():
    """Equation 4 and the gram loss of section 3.3: sums over layers, regions or slices, and
    numbers, of one crop; a mean over the crops of the batch.
    """
    settings = {**SMALL, "generator": "subpixel", "crop": 32, "reduction": "sum"}
    config = GanConfig(**{**PRESETS["paper"], **settings})
    pair, real, fake, _, of_generator = step(config)
    with torch.no_grad():
        features, known, candidates = (
            [part.double().numpy() for part in pair.discriminator.features(crops)]
            for crops in (fake, real, draw(2, 3, 1, 32, 32, 32)[:2])
        )
        last = pair.discriminator.features(draw(2, 3, 1, 32, 32, 32)[2:])
        wanted = -log_sigmoid(pair.discriminator(fake)[0]).mean()
    for layer, edge in enumerate((8, 4, 2)):
        for made, other in zip(features[layer], known[layer], strict=True):
            side = made.shape[1]
            apart = (gram_matrices(made) - gram_matrices(other)) * side**2
            wanted += 0.1 * np.square(apart).sum() / config.batch
        asked = regions(features[layer], edge)
        parts = candidates[layer], last[layer].double().numpy()
        table = np.concatenate([regions(part, edge) for part in parts])
        wanted += np.square(asked[:, None] - table[None]).sum(2).min(1).sum() / config.batch
    assert of_generator == pytest.approx(wanted, rel=1e-4)


def test_gradient_shares_are_told_and_change_nothing():
    """Twice the weight is twice the share; the weights move as without the shares."""
    settings = {**SMALL, "generator": "subpixel", "crop": 32, "batch": 2}
    moved, shares = [], []
    for gram, told in ((0.1, False), (0.1, True), (0.2, True)):
        config = GanConfig(**{**PRESETS["gram"], **settings, "gram": gram})
        pair = AdversarialPair(config, 1, torch.device("cpu"))
        real = torch.tanh(draw(1, 2, 1, 32, 32, 32))
        found = pair.train_step(real, torch.Generator().manual_seed(5), 0, 0.0, shares=told)
        moved.append(pair.state())
        shares.append(found.get("gram_share"))
    assert all(torch.equal(moved[0][name], moved[1][name]) for name in moved[0])
    assert shares[0] is None and shares[1] > 0
    assert shares[2] == pytest.approx(2 * shares[1], rel=1e-4)


@pytest.mark.parametrize("iteration", [0, 1])
def test_a_step_takes_r1_and_the_sliced_distance_every_other_time(iteration):
    """Relativistic losses of both networks (Huang et al. 2024), gamma / 2 of R1 and the sliced
    distance: doubled, as every other iteration has them.
    """
    config = GanConfig(**SMALL, crop=40, penalty=0.7, sliced=3.0)
    pair, real, fake, of_discriminator, of_generator = step(config, iteration)
    real.requires_grad_(True)
    on_real, on_fake = pair.discriminator(real), pair.discriminator(fake)
    pairs = [(a.detach(), b.detach()) for a, b in zip(on_real, on_fake, strict=True)]
    wanted = -sum(log_sigmoid(a - b).mean() for a, b in pairs)
    squared = 0.0
    for crop in range(config.batch):  # verdicts of both scales, each over the root of its number
        total = sum(v[crop].sum() / v[crop].numel() ** 0.5 for v in on_real)
        (slope,) = torch.autograd.grad(total, real, retain_graph=True)
        squared += float(slope.double().square().sum()) / config.batch
    assert squared > 0.01
    wanted += (0.7 / 2) * 2 * squared * (iteration == 0)
    assert of_discriminator == pytest.approx(wanted, rel=1e-4)
    random = torch.Generator().manual_seed(5)
    pair.generate(random)
    apart = losses.sliced(fake, real.detach(), random)
    wanted = -sum(log_sigmoid(b - a).mean() for a, b in pairs)
    wanted += 3.0 * 2 * float(apart) * (iteration == 0)
    assert of_generator == pytest.approx(wanted, rel=1e-4)


@pytest.mark.parametrize("warm", [False, True])
def test_a_step_holds_the_generator_to_the_fractions_that_it_was_given(warm):
    """The squared distance of the fractions around cells, in variances of the exemplar's, times
    its weight: a tenth of that in the warm-up.
    """
    config = GanConfig(**SMALL, crop=64, penalty=0.0, sliced=0.0, fractions=3.0)
    fields = exemplar_fields(tb.sample("bone"), config)
    real, given = fields.crops(2, 0, 0), fields.given(2, 0, 0)
    pair = AdversarialPair(config, 1, torch.device("cpu"), (), fields.local)
    found = {}
    pair._step = lambda network, loss: found.update({network: loss.item()})
    random = torch.Generator().manual_seed(5)
    with torch.no_grad():
        fake = pair.generate(torch.Generator().manual_seed(5), given)
        shares = 1 / (1 + np.exp(-8 * fake[:, 0].double().numpy()))
    cells = shares.reshape(2, 8, 8, 8, 8, 8, 8).mean((2, 4, 6))
    line = np.array([1, 4, 6, 4, 1]) / 16
    windows = np.lib.stride_tricks.sliding_window_view(cells, (5, 5, 5), (1, 2, 3))
    around = np.einsum("nzyxabc,a,b,c->nzyx", windows, line, line, line)
    apart = (around - fields.local.mean[0]) / fields.local.deviation[0]
    obeyed = np.square(apart - given[:, 0, 5:-5, 5:-5, 5:-5].double().numpy()).mean()
    if warm:
        parts = pair.warmup_step(real, random, given=given)
        assert found[0] == pytest.approx(parts["sliced"] + 0.1 * 3 * obeyed, rel=1e-4)
        return
    parts = pair.train_step(real, random, 1, 0.0, given=given)
    assert parts["fractions"] == pytest.approx(obeyed, rel=1e-4)
    assert found[0] == pytest.approx(parts["generator"] + 3 * obeyed, rel=1e-4)


def test_noise_hides_real_and_generated_crops_alike():
    config = GanConfig(**SMALL, crop=40, penalty=0.0, sliced=0.0)
    seen = []
    pair = AdversarialPair(config, 1, torch.device("cpu"))
    forward = pair.discriminator.forward
    pair.discriminator.forward = lambda x: seen.append(x.detach()) or forward(x)
    real = torch.tanh(draw(1, 2, 1, 40, 40, 40))
    pair.train_step(real, torch.Generator().manual_seed(5), 0, 0.3)
    assert len(seen) == 3 and torch.equal(seen[1], seen[2])
    assert float((seen[0] - real).std()) == pytest.approx(0.3, rel=0.02)


def test_both_networks_go_downhill():
    """Adam's first step is the rate times the sign of the slope of the network's own loss."""
    config = GanConfig(**SMALL, crop=40, penalty=0.0, sliced=0.0, rate=1e-4)
    pair, real, fake, of_discriminator, of_generator = step(config)
    del pair._step
    before = pair.state()
    pair.train_step(real, torch.Generator().manual_seed(5), 1, 0.0)
    with torch.no_grad():
        on_real = pair.discriminator(real)
        assert float(losses.relativistic(on_real, pair.discriminator(fake))) < of_discriminator
        moved = pair.generate(torch.Generator().manual_seed(5))
        pair.restore({**pair.state(), **{n: t for n, t in before.items() if n[0] == "d"}})
        on_real, on_moved = pair.discriminator(real), pair.discriminator(moved)
        assert float(losses.relativistic(on_moved, on_real)) < of_generator


def test_the_presets_hold_the_papers_numbers():
    """Zhang et al. 2021, sections 3.4 and 4.2, and its ablations."""
    paper = dataclasses.asdict(GanConfig(**PRESETS["paper"]))
    wanted = {
        "generator": "deconvolution", "discriminator": "score", "adversarial": "standard",
        "width": 64, "latent": 100, "crop": 64, "batch": 100, "rate": 2e-4, "iterations": 40000,
        "gram": 0.1, "structural": 1.0, "penalty": 0.0, "sliced": 0.0, "warmup": 0.0,
        "noise": (0.0, 0.0), "decay": 0.0, "average": 0.0, "clip": 0.0, "orientations": "none",
    }  # fmt: skip
    assert {name: paper[name] for name in wanted} == wanted
    weights = {name: (GanConfig(**PRESETS[name]).gram, GanConfig(**PRESETS[name]).structural)
               for name in ("3dgan", "patchgan", "gram", "structural", "all")}  # fmt: skip
    assert weights == {
        "3dgan": (0, 0), "patchgan": (0, 0), "gram": (0.1, 0), "structural": (0, 1), "all": (0.1, 1)
    }  # fmt: skip
    assert losses.EDGES == (8, 4, 2), "regions of the first three layers"


@pytest.mark.parametrize(("preset", "betas"), [("paper", (0.5, 0.999)), ("compact", (0.5, 0.99))])
def test_adam_has_the_rate_of_the_config_times_the_schedule(preset, betas):
    config = GanConfig(**{**PRESETS[preset], **SMALL})
    pair = AdversarialPair(config, 1, torch.device("cpu"))
    groups = [group for optimiser in pair.optimisers for group in optimiser.param_groups]
    assert [(group["lr"], group["betas"]) for group in groups] == [(config.rate, betas)] * 2
    pair.set_learning_rate(0.25)
    assert [group["lr"] for group in groups] == [config.rate / 4] * 2


def test_the_rate_falls_over_the_last_share_of_the_training():
    config = GanConfig(decay=0.4)
    rates = [TrainingState(pace=0.5).rate(done, config) for done in (0.0, 0.6, 0.8, 0.9)]
    assert rates == pytest.approx([0.5, 0.5, 0.25, 0.125])
    assert TrainingState().rate(0.9, GanConfig(decay=0.0)) == 1


def test_a_batch_is_as_large_as_the_config_says():
    for batch in (1, 3):
        pair = AdversarialPair(GanConfig(**{**SMALL, "batch": batch}), 1, torch.device("cpu"))
        assert len(pair.sample(torch.Generator().manual_seed(0))) == batch


def test_the_widths_of_the_two_scales():
    """Each scale doubles its channels twice; the first layer sees 2^3 voxels as channels."""
    with torch.device("meta"):
        network = new_discriminator(GanConfig(width=16), 1)
    for scale in (network.near, network.far):
        channels = [(layer.in_channels, layer.out_channels) for layer in scale]
        assert channels == [(8, 32), (32, 64), (64, 128), (128, 1)]
