"""The table of materials of path-traced stills, and materials of a reader's own from a small file.

Colours are sRGB, 0..255, of a thick body in white light. Lengths are shares of the longest edge of
the box around the material, so that a look does not depend on how finely it is resolved.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.checks import as_number, check_name, quote
from trabecula.core.errors import InputError
from trabecula.view.looks import LOOKS, Look, to_linear
from trabecula.view.trace import texture

Colour = tuple[float, float, float]


def _as_colour(value: Any, name: str) -> Colour:
    try:
        red, green, blue = (float(each) for each in value)
    except (TypeError, ValueError):
        raise InputError(f"{name} {quote(value)} should be red, green, blue, 0..255") from None
    if not all(0 <= each <= 255 for each in (red, green, blue)):
        raise InputError(f"{name} {quote(value)} should be red, green, blue, 0..255")
    return red, green, blue


_SHARES = (
    "roughness", "specular", "metalness", "transmission", "grain", "veins", "vein_width", "specks",
    "flour", "rim_roughness",
)  # fmt: skip
_LENGTHS = (
    "scattering_depth", "absorption_depth", "grain_size", "vein_spacing", "speck_size", "bump_size",
    "rim_patch",
)  # fmt: skip


@dataclass(frozen=True)
class PhaseMaterial:
    """What one phase is made of.

    Parameters
    ----------
    albedo : colour
        Share of the light that comes back, of a metal that is mirrored; of a clear material the
        light left after `absorption_depth`.
    roughness : float
        0 (polished) .. 1 (matt): width of highlights (GGX, the square is its alpha).
    specular : float
        0..1, 0.08 of it is mirrored squarely: 0.5 is a refractive index of 1.5.
    metalness : float
        0..1: how far it is a conductor, whose mirror has the albedo's hue.
    scattering_depth : float
        Mean free path of light in it; 0: light comes back where it falls.
    transmission : float
        0..1: share of the light that passes as through glass.
    refraction : float
        Refractive index, 1.01..3, of what is transmitted.
    absorption_depth : float
    grain, grain_size, grain_albedo
        How far clouds of noise take a second albedo, and their size.
    veins, vein_spacing, vein_width, vein_albedo
        Strength 0..1 of veins, distance, share of the distance they are wide, albedo.
    specks, speck_size, speck_albedo
        Share of cells that hold a grain of another albedo, and the cells' size.
    bump, bump_size : float
        Slope 0..2 of fine roughness that the voxels do not hold, and its size.
    rim : tuple of (depth, colour)
        Albedo by the depth below the outside of the form, from 0 on; at `rim_end` the albedo
        is reached. Pores that open outwards belong to the form.
    rim_end : float
    rim_unevenness, rim_patch
        How uneven the depth of the rim is, 0..1, and the size of its patches.
    rim_roughness : float
        Roughness of the outside.
    flour : float
        0..1: white dust on what faces up of the rim.
    """

    albedo: Colour = (200, 200, 200)
    roughness: float = 0.6
    specular: float = 0.4
    metalness: float = 0.0
    scattering_depth: float = 0.0
    transmission: float = 0.0
    refraction: float = 1.5
    absorption_depth: float = 0.2
    grain: float = 0.0
    grain_size: float = 0.1
    grain_albedo: Colour = (120, 120, 120)
    veins: float = 0.0
    vein_spacing: float = 0.3
    vein_width: float = 0.08
    vein_albedo: Colour = (90, 90, 90)
    specks: float = 0.0
    speck_size: float = 0.03
    speck_albedo: Colour = (60, 60, 60)
    bump: float = 0.0
    bump_size: float = 0.01
    rim: tuple[tuple[float, Colour], ...] = ()
    rim_end: float = 0.03
    rim_unevenness: float = 0.6
    rim_patch: float = 0.12
    rim_roughness: float = 0.6
    flour: float = 0.0

    def __post_init__(self) -> None:
        for name in _SHARES:
            self._check(name, 0, 1)
        for name in _LENGTHS:
            self._check(name, 0, 10)
        for name, low, high in (
            ("refraction", 1.01, 3), ("bump", 0, 2), ("rim_end", 0, 10), ("rim_unevenness", 0, 1),
        ):  # fmt: skip
            self._check(name, low, high)
        for each in fields(self):
            if each.name.endswith("albedo"):
                object.__setattr__(self, each.name, _as_colour(getattr(self, each.name), each.name))
        object.__setattr__(self, "rim", self._as_rim())

    def _check(self, name: str, low: float, high: float) -> None:
        value = as_number(getattr(self, name), name=name, low=low, high=high)
        object.__setattr__(self, name, value)

    def _as_rim(self) -> tuple[tuple[float, Colour], ...]:
        stops = []
        try:
            for depth, colour in self.rim:
                stops.append((float(depth), _as_colour(colour, "rim")))
        except (TypeError, ValueError):
            raise InputError(
                f"rim {quote(self.rim)}: give pairs of a depth and a colour, as in "
                "[[0.0, [120, 70, 30]], [0.01, [200, 150, 90]]]"
            ) from None
        depths = [depth for depth, _ in stops]
        least = texture.RIM_STOPS - 1
        if stops and (
            len(stops) > least or depths[0] != 0 or sorted(set(depths)) != depths
            or depths[-1] >= self.rim_end
        ):  # fmt: skip
            raise InputError(
                f"rim at depths {depths}: give at most {least}, from 0 rising to below "
                f"rim_end={self.rim_end:g}"
            )
        return tuple(stops)

    def row(self, length: float) -> np.ndarray:
        """Return its numbers for `texture`, of a form whose longest edge is `length`."""
        row = np.zeros(texture.WIDTH)
        row[texture.ALBEDO : 3] = to_linear(self.albedo)
        row[texture.ROUGHNESS] = self.roughness
        row[texture.SPECULAR] = self.specular
        row[texture.METALNESS] = self.metalness
        # below a third of a voxel light comes back where it falls
        depth = self.scattering_depth * length
        row[texture.SCATTERING] = depth if depth >= 0.33 else 0.0
        row[texture.TRANSMISSION] = self.transmission
        row[texture.REFRACTION] = self.refraction
        row[texture.ABSORPTION] = max(self.absorption_depth * length, 1e-3)
        for at, name in (
            (texture.GRAIN, "grain"), (texture.VEINS, "vein"), (texture.SPECKS, "speck"),
        ):  # fmt: skip
            row[at] = getattr(self, {"vein": "veins", "speck": "specks"}.get(name, name))
            size = getattr(self, "vein_spacing" if name == "vein" else f"{name}_size")
            row[at + 1] = max(size * length, 1e-3)
            albedo = at + (3 if name == "vein" else 2)
            row[albedo : albedo + 3] = to_linear(getattr(self, f"{name}_albedo"))
        row[texture.VEIN_WIDTH] = max(self.vein_width, 1e-3)
        row[texture.BUMP] = self.bump
        row[texture.BUMP_SIZE] = max(self.bump_size * length, 1e-3)
        row[texture.UNEVENNESS] = self.rim_unevenness
        row[texture.PATCH] = max(self.rim_patch * length, 1e-3)
        row[texture.FLOUR] = self.flour
        row[texture.RIM_ROUGHNESS] = self.rim_roughness
        stops = [*self.rim, (self.rim_end, self.albedo)] if self.rim else []
        row[texture.STOPS] = len(stops)
        for n, (depth, colour) in enumerate(stops):
            at = texture.RIM + 4 * n
            row[at], row[at + 1 : at + 4] = depth * length, to_linear(colour)
        return row


@dataclass(frozen=True)
class TracedLook:
    """Materials of the phases that are drawn, and the light on them.

    Parameters
    ----------
    materials : tuple of PhaseMaterial
        Of the first phase that is not void, of the next, ...; those beyond take plain colours.
    void : PhaseMaterial
        Of the phase named "void", where it is drawn (marrow, resin).
    light : {"window", "studio", "overcast"}
    background : colour
    """

    materials: tuple[PhaseMaterial, ...] = (PhaseMaterial(),)
    void: PhaseMaterial = field(default_factory=lambda: PhaseMaterial(albedo=(90, 90, 96)))
    light: str = "window"
    background: Colour = (226, 223, 218)

    def to_json(self) -> dict[str, Any]:
        """Return it as plain values."""
        return asdict(self)


_CRUST = (
    (0.0, (138, 78, 34)),
    (0.006, (182, 114, 56)),
    (0.013, (212, 158, 94)),
)

TRACED: dict[str, TracedLook] = {
    "bread": TracedLook(
        materials=(
            PhaseMaterial(
                albedo=(232, 205, 156), roughness=0.9, specular=0.2, scattering_depth=0.0025,
                grain=0.4, grain_size=0.16, grain_albedo=(222, 188, 132),
                bump=0.35, bump_size=0.006,
                rim=_CRUST, rim_end=0.026, rim_unevenness=0.75, rim_patch=0.11,
                rim_roughness=0.5, flour=0.0,
            ),
        ),
        background=(222, 216, 206),
    ),
    "sponge": TracedLook(
        materials=(
            PhaseMaterial(
                albedo=(240, 192, 58), roughness=0.9, specular=0.12, scattering_depth=0.0024,
                grain=0.3, grain_size=0.2, grain_albedo=(230, 168, 40), bump=0.25, bump_size=0.005,
            ),
        ),
        background=(222, 228, 230),
    ),
    "stone": TracedLook(
        materials=(
            PhaseMaterial(
                albedo=(150, 138, 124), roughness=0.85, specular=0.3,
                grain=0.8, grain_size=0.05, grain_albedo=(106, 97, 90),
                veins=0.25, vein_spacing=0.4, vein_width=0.06, vein_albedo=(196, 188, 176),
                specks=0.3, speck_size=0.012, speck_albedo=(66, 60, 56),
                bump=0.6, bump_size=0.006,
            ),
        ),
        background=(214, 214, 212),
    ),
    "cheese": TracedLook(
        materials=(
            PhaseMaterial(
                albedo=(250, 214, 112), roughness=0.38, specular=0.45, scattering_depth=0.012,
                grain=0.25, grain_size=0.3, grain_albedo=(246, 200, 90), bump=0.06, bump_size=0.01,
                rim=((0.0, (206, 148, 62)), (0.006, (232, 182, 84))), rim_end=0.016,
                rim_unevenness=0.3, rim_patch=0.3, rim_roughness=0.5,
            ),
        ),
        background=(224, 222, 218),
    ),
    "bone": TracedLook(
        materials=(
            PhaseMaterial(
                albedo=(238, 224, 194), roughness=0.45, specular=0.5, scattering_depth=0.006,
                grain=0.35, grain_size=0.07, grain_albedo=(222, 198, 156), bump=0.12,
                bump_size=0.006,
            ),
        ),
        void=PhaseMaterial(
            albedo=(164, 66, 46), roughness=0.25, specular=0.5, scattering_depth=0.006,
            grain=0.5, grain_size=0.05, grain_albedo=(196, 120, 60), bump=0.1, bump_size=0.01,
        ),
        background=(206, 208, 212),
    ),
    "foam": TracedLook(
        materials=(
            PhaseMaterial(
                albedo=(206, 208, 210), roughness=0.32, metalness=1.0, grain=0.3, grain_size=0.02,
                grain_albedo=(176, 178, 182), bump=0.18, bump_size=0.006,
            ),
        ),
        light="studio",
        background=(196, 200, 206),
    ),
    "copper": TracedLook(
        materials=(
            PhaseMaterial(
                albedo=(244, 160, 122), roughness=0.3, metalness=1.0, grain=0.4, grain_size=0.04,
                grain_albedo=(196, 112, 84), bump=0.15, bump_size=0.006,
            ),
        ),
        light="studio",
        background=(206, 206, 208),
    ),
    "ceramic": TracedLook(
        materials=(
            PhaseMaterial(
                albedo=(240, 238, 232), roughness=0.3, specular=0.6, scattering_depth=0.004,
                bump=0.05, bump_size=0.008,
            ),
        ),
        background=(204, 208, 214),
    ),
    "rock": TracedLook(
        materials=(
            PhaseMaterial(
                albedo=(198, 164, 122), roughness=0.9, specular=0.25,
                grain=0.7, grain_size=0.04, grain_albedo=(160, 120, 82),
                specks=0.35, speck_size=0.016, speck_albedo=(226, 210, 186),
                bump=0.7, bump_size=0.007,
            ),
        ),
        void=PhaseMaterial(
            albedo=(42, 96, 150), roughness=0.1, specular=0.5, scattering_depth=0.01
        ),
        background=(216, 216, 216),
    ),
    "glass": TracedLook(
        materials=(
            PhaseMaterial(
                albedo=(190, 226, 214), roughness=0.02, specular=0.5, transmission=1.0,
                absorption_depth=0.25,
            ),
        ),
        light="studio",
        background=(214, 218, 222),
    ),
    "wax": TracedLook(
        materials=(
            PhaseMaterial(
                albedo=(244, 232, 206), roughness=0.35, specular=0.5, scattering_depth=0.02,
            ),
        ),
        background=(206, 204, 202),
    ),
    "clay": TracedLook(
        materials=(PhaseMaterial(albedo=(206, 200, 192), roughness=0.9, specular=0.2),),
    ),
}  # fmt: skip

_FURTHER = ((86, 150, 196), (214, 122, 60), (62, 150, 118), (204, 132, 172), (128, 96, 168))


def find_traced(look: str | PathLike[str] | Mapping[str, Any]) -> TracedLook:
    """Return a look by its name, or of one's own.

    Parameters
    ----------
    look : str, path or mapping
        A name; or a .toml file, or its content, with `base` (a name), `light`, `background`, the
        parameters of the first `PhaseMaterial`, and tables `void`, `second`, `third` of others.

    Raises
    ------
    UnknownNameError
        No look, no parameter or no light of that name.
    InputError
        A file that cannot be read, or a parameter out of range.
    """
    if isinstance(look, Mapping):
        return _own(dict(look), "look")
    if str(look).endswith(".toml"):
        return _own(read_look(look), Path(look).name)
    check_name(str(look), TRACED, name="look")
    return TRACED[str(look)]


def read_look(path: str | PathLike[str]) -> dict[str, Any]:
    """Read a .toml file of a look of one's own."""
    path = Path(path)
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"the look {path.name} cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"the look {path.name} is no TOML file: {error}") from None


def _own(table: dict[str, Any], name: str) -> TracedLook:
    base = find_traced(str(table.pop("base", "clay")))
    light = table.pop("light", base.light)
    check_name(light, LIGHTS, name="light")
    background = _as_colour(table.pop("background", base.background), "background")
    void = _changed(base.void, table.pop("void", {}), name)
    further = [
        _changed(_plain(number), table.pop(word), name)
        for number, word in enumerate(("second", "third"), 1)
        if word in table
    ]
    materials = (_changed(base.materials[0], table, name), *further)
    return TracedLook(materials, void, light, background)


def _changed(material: PhaseMaterial, table: Any, name: str) -> PhaseMaterial:
    if not isinstance(table, Mapping):
        raise InputError(f"{name}: {quote(table)} should be a table of a material's parameters")
    known = [each.name for each in fields(PhaseMaterial)]
    for word in table:
        check_name(word, known, name=f"parameter in {name}")
    return replace(material, **table)


def _plain(number: int) -> PhaseMaterial:
    return PhaseMaterial(albedo=_FURTHER[(number - 1) % len(_FURTHER)])


def material_rows(look: TracedLook, phases: tuple[str, ...], length: float) -> np.ndarray:
    """Return (N, WIDTH), a row a phase: materials in the order of the phases that are not void."""
    rows, number = [], 0
    for phase in phases:
        if phase == "void":
            rows.append(look.void.row(length))
            continue
        known = number < len(look.materials)
        rows.append((look.materials[number] if known else _plain(number)).row(length))
        number += 1
    return np.array(rows)


@dataclass(frozen=True)
class LightTable:
    """A lamp and a sky.

    Parameters
    ----------
    side, height : float
        Of the lamp: degrees from the viewer's direction to the left, and above level.
    size : float
        Degrees across that the lamp is seen under: soft shadows where large.
    key : colour
        Irradiance of a surface that faces the lamp, over that of a white page, pi.
    zenith, horizon, below : colour
        Radiance of the sky.
    window, glow
        (side, height, sharpness) of a bright part of the sky, and its radiance.
    """

    side: float
    height: float
    size: float
    key: Colour
    zenith: Colour
    horizon: Colour
    below: Colour
    window: tuple[float, float, float]
    glow: Colour


LIGHTS = {
    "window": LightTable(
        side=58, height=42, size=16, key=(0.98, 0.92, 0.82), zenith=(0.30, 0.33, 0.38),
        horizon=(0.26, 0.26, 0.27), below=(0.16, 0.15, 0.14), window=(-110, 20, 6),
        glow=(0.20, 0.22, 0.26),
    ),
    "studio": LightTable(
        side=50, height=46, size=22, key=(0.80, 0.79, 0.77), zenith=(0.34, 0.35, 0.37),
        horizon=(0.10, 0.10, 0.11), below=(0.10, 0.10, 0.10), window=(-75, 25, 14),
        glow=(1.1, 1.12, 1.18),
    ),
    "overcast": LightTable(
        side=30, height=70, size=70, key=(0.35, 0.35, 0.36), zenith=(0.74, 0.76, 0.80),
        horizon=(0.40, 0.41, 0.43), below=(0.18, 0.18, 0.18), window=(0, 0, 0),
        glow=(0.0, 0.0, 0.0),
    ),
}  # fmt: skip


def plain_look(look: str | PathLike[str] | Mapping[str, Any]) -> Look:
    """Return the look of the quick still: one of `looks.LOOKS`, or what that model of light can
    show of a traced one.
    """
    if isinstance(look, str) and look in LOOKS:
        return LOOKS[look]
    traced = find_traced(look)
    first = traced.materials[0]
    deep = first.scattering_depth > 0 or first.transmission > 0
    return Look(
        solid=_whole(first.albedo),
        void=_whole(traced.void.albedo),
        background=_whole(traced.background),
        roughness=first.roughness,
        specular=1.0 if first.metalness > 0.5 else first.specular,
        absorption=1.8 if deep else 10.0,
        scattering=0.6 if deep else 0.0,
    )


def _whole(colour: Colour) -> tuple[int, int, int]:
    red, green, blue = (round(each) for each in colour)
    return red, green, blue
