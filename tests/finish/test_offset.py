"""Offset: the fraction is met to the voxel, topology stays, and the surface moves evenly."""

import numpy as np
import pytest
from scipy import ndimage

import trabecula as tb
from trabecula.errors import InputError
from trabecula.finish import offset
from trabecula.measure import components, specific_surface


def report(image):
    return image.recipe.steps[-1]["report"]


def topology(solid, *, periodic=False):
    """Return the parts of a phase (26 neighbours), those of the rest (6, open at faces), and the
    Euler number, from cells.
    """
    pad = np.pad(solid, 1, mode="wrap" if periodic else "constant")
    parts = components(solid, connectivity=26, periodic=periodic)
    holes = ndimage.label(~np.pad(solid, 1))[1] if not periodic else 0
    return int(parts), int(holes), euler(pad, solid.shape if periodic else None)


def euler(pad, period):
    """Count vertices, edges, faces and voxels of a union of closed voxels."""
    total = 0
    for bits in np.ndindex(2, 2, 2):  # a cell is as long as a voxel along axes with bit 1
        cells = np.zeros_like(pad)
        for near in np.ndindex(*[1 if bit else 2 for bit in bits]):
            cells |= np.roll(pad, near, (0, 1, 2))
        inner = cells if period is None else cells[1:-1, 1:-1, 1:-1]
        total += (-1) ** sum(bits) * int(np.count_nonzero(inner))
    return total


def grains(shape=(24, 24, 24), share=0.4, seed=0, sigma=2.0):
    noise = np.random.default_rng(seed).random(shape)
    field = ndimage.gaussian_filter(noise, sigma, mode="wrap")
    return field < np.quantile(field, share)


@pytest.mark.parametrize("change", [-0.08, -0.01, 0.01, 0.08])
@pytest.mark.parametrize("periodic", [False, True])
def test_the_fraction_is_met_and_nothing_joins_or_breaks(change, periodic):
    solid = grains()
    part = offset(solid, fraction=solid.mean() + change, periodic=periodic)
    after = part.values == 1
    told = report(part)
    assert np.count_nonzero(after) == round((solid.mean() + change) * solid.size)
    assert (after >= solid).all() if change > 0 else (after <= solid).all()
    assert topology(after, periodic=periodic) == topology(solid, periodic=periodic)
    assert told["added" if change > 0 else "removed"] == round(abs(change) * solid.size)
    assert told["layers"] >= 1


@pytest.mark.whole
@pytest.mark.parametrize("periodic", [False, True])
def test_topology_stays_in_any_volume(periodic):
    draw, met = np.random.default_rng(0), 0
    for _ in range(150):
        solid = draw.random(tuple(draw.integers(4, 9, 3))) < draw.uniform(0.1, 0.7)
        wanted = float(np.clip(solid.mean() + draw.uniform(-0.1, 0.1), 0, 1))
        try:
            after = offset(solid, fraction=wanted, periodic=periodic).values == 1
        except InputError as err:
            assert "beyond what the surface can reach" in str(err)
            continue
        met += 1
        assert topology(after, periodic=periodic) == topology(solid, periodic=periodic)
    assert met > 100


def test_a_ball_stays_round_and_a_strut_as_even_as_its_surface():
    z, y, x = np.indices((40, 40, 40)) - 19.5
    ball = z**2 + y**2 + x**2 < 12**2
    for wanted in (10.5, 11.5, 12.5, 13.5):
        part = offset(ball, fraction=4 / 3 * np.pi * wanted**3 / ball.size).values == 1
        far = np.sqrt(z**2 + y**2 + x**2)
        assert far[part].max() < wanted + 1.3 and far[~part].min() > wanted - 1.3
    rod = np.zeros((24, 24, 60), bool)
    rod[8:14, 8:14] = True
    thin = offset(rod, fraction=0.9 * rod.mean()).values == 1
    shares = thin.sum(axis=(0, 1)).reshape(6, 10).mean(axis=1) / 36
    assert shares.min() > 0.84 and shares.max() < 0.96


def test_thin_and_thick_parts_lose_as_much_depth():
    part = np.zeros((20, 40, 40), bool)
    part[2:4], part[9:18] = True, True
    after = offset(part, fraction=part.mean() - 0.04).values == 1
    thin, thick = 2 - after[:6].mean() * 6, 9 - after[6:].mean() * 14
    assert thin == pytest.approx(thick, rel=0.35) and thin > 0.2


@pytest.mark.whole
def test_bone_keeps_its_surface():
    bone = tb.crop(tb.sample("bone"), 64)
    solid = (bone.values == bone.phases.index("solid")).mean()
    for change in (-0.01, 0.01):
        part = offset(bone, fraction=solid + change)
        assert specific_surface(part) / specific_surface(bone) == pytest.approx(1, abs=0.04)


def test_pores_that_are_open_at_a_face_stay_open():
    block = np.ones((12, 12, 12), bool)
    block[5:7, 5:7] = False
    part = offset(block, fraction=1 - 24 / block.size).values == 1
    assert (~part).sum() == 24 and (~part).any(axis=(0, 1)).all()
    with pytest.raises(InputError, match=r"fraction 1 is beyond .* which is 0\.99\d*"):
        offset(block, fraction=1)


def test_what_cannot_be_is_refused():
    with pytest.raises(InputError, match="holds nothing of phase 'solid'"):
        offset(np.zeros((8, 8, 8), int), fraction=0.1)
    with pytest.raises(InputError, match=r"fraction=1.2 is outside"):
        offset(grains(), fraction=1.2)


def test_other_phases_and_the_outside_of_a_form_stay():
    values = np.zeros((20, 20, 20), np.uint8)
    values[4:12, 4:16, 4:16], values[12:16, 4:16, 4:16] = 1, 2
    image = tb.Image(values, "labels", phases=("void", "a", "b"))
    part = offset(image, phase="a", fraction=0.17)
    assert np.array_equal(part.values == 2, values == 2) and np.mean(part.values == 1) == 0.17
    form = np.zeros((20, 20, 20), bool)
    form[:, :, :14] = True
    part = offset(image, fraction=0.35, mask=form)
    assert np.array_equal(part.values[:, :, 14:], values[:, :, 14:])
    assert np.count_nonzero(part.values[form]) == round(0.35 * form.sum())
    grown = part.values * (values == 0)
    assert np.all(grown[:11] != 2) and np.all(grown[13:] != 1) and {1, 2} <= set(np.unique(grown))


@pytest.mark.whole
def test_slices_and_recipes(tmp_path):
    flat = grains((40, 40), seed=3)
    part = offset(flat, fraction=flat.mean() + 0.03)
    assert part.values.sum() == round((flat.mean() + 0.03) * flat.size)
    assert ndimage.label(part.values, np.ones((3, 3)))[1] == ndimage.label(flat, np.ones((3, 3)))[1]
    bone = tb.crop(tb.sample("bone"), 24)
    moved = offset(bone, fraction=0.2)
    tb.write(moved, tmp_path / "x.nrrd")
    assert np.array_equal(tb.rerun(tmp_path / "x.nrrd").values, moved.values)
