"""`gan`: fit trains a generator, generate makes any box of an unlimited material."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from trabecula.core.checks import as_spacing
from trabecula.core.errors import InputError, RequestError
from trabecula.core.image import Image
from trabecula.core.optional import need
from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.core.target import Target, porosity_of
from trabecula.engine.blocks import Box
from trabecula.engine.parallel import thread_count
from trabecula.exemplar.views import spacing_of, views_of
from trabecula.synth.api.exemplar_info import ExemplarInfo
from trabecula.synth.api.method import Method, ModelState
from trabecula.synth.api.windows import WindowModel, field_in
from trabecula.synth.gan import CAPABILITIES
from trabecula.synth.gan.config import GanConfig
from trabecula.synth.gan.decode import CELLS, Flips, Given, decode, make_tiles, margin_cells
from trabecula.synth.gan.local_fractions import LocalFractions, cell_means
from trabecula.synth.gan.patterns import join_arrays, learn_bias, make_flips, split_arrays
from trabecula.synth.shared.patterns.bias import PatternBias
from trabecula.synth.shared.patterns.counts import LEAST_VOXELS
from trabecula.synth.shared.patterns.flips import LOCAL
from trabecula.synth.shared.pictures import check_gap, check_pictures_agree
from trabecula.synth.shared.tiles import tile_with_halo

PROCESS = 485 << 20
"""Bytes of the interpreter with NumPy, Numba and torch loaded."""

_SLACK = 1e-3  # of a porosity beyond the range
_AUTOGRAD = 40 << 20  # bytes of torch's code for training, loaded
_LATENT = 200 << 10  # bytes of a tile's latent and the places of the tiles


class Gan(Method):
    """A generative adversarial network."""

    capabilities = CAPABILITIES
    config_type = GanConfig

    def learn(self, exemplars: Sequence[Image]) -> GanModel:
        need("torch", extra="learn", purpose="method 'gan'")
        from trabecula.synth.gan.crops import effective_config
        from trabecula.synth.gan.train import train

        parts = train(self.config, exemplars)
        if exemplars[0].ndim == 2:
            views = views_of(exemplars, self.config.views, gap=self.config.gap)
            spacing = spacing_of(views)
            parts["spacing"] = [float(edge) for edge in spacing]
        # What it learnt without stands in the model's settings.
        return GanModel(effective_config(self.config, exemplars), exemplars, parts)

    def memory(self, exemplars: Sequence[Image]) -> Mapping[str, int]:
        """Forecast the bytes of the process; those of a GPU are checked when it trains."""
        need("torch", extra="learn", purpose="method 'gan'")
        from trabecula.synth.gan.forecast import host_bytes
        from trabecula.synth.gan.train import find_device

        found = host_bytes(self.config, exemplars, find_device(self.config))
        return {"interpreter and kernels": PROCESS + _AUTOGRAD, **found}

    def _check_exemplars(self, images: Sequence[Image]) -> None:
        if self.config.gap:
            check_gap(images, self.config.gap)
        if all(image.ndim == 3 for image in images):
            if len(images) > 1:
                raise InputError(f"method 'gan' learns from one volume, got {len(images)}")
            self._check_exemplar(images[0])
            return
        for image in images:
            self._check_exemplar(image)
        if any(image.ndim == 3 for image in images):
            raise InputError("method 'gan' learns from one volume, or from pictures: not from both")
        check_pictures_agree(images)
        if self.config.discriminator != "scales":
            raise InputError(
                f"discriminator={self.config.discriminator!r} judges volumes: from pictures it is "
                "'scales'"
            )

    def from_state(self, exemplars: Sequence[Any], state: ModelState) -> GanModel:
        """Build the model that `GanModel.state` described."""
        weights, bias = split_arrays(state.arrays, state.plain)
        parts = {"generator": weights, "bias": bias, **state.plain, "training": state.history}
        return build_model(self.config, exemplars, parts)


class GanModel(WindowModel):
    """A trained generator.

    Parameters
    ----------
    config : GanConfig
    exemplars : sequence of Image or ExemplarInfo
    parts : dict
        "generator": tensors or arrays by name; "calibration" and "training": plain JSON (see
        `decode` and `train`); "fractions", where it takes local fractions: plain JSON (see
        `LocalFractions`); "bias": a `PatternBias`, or None.
    """

    capabilities = CAPABILITIES
    config: GanConfig

    def __init__(
        self, config: GanConfig, exemplars: Sequence[Image | ExemplarInfo], parts: Mapping[str, Any]
    ) -> None:
        # Where the training left its pictures is no part of what it learned.
        super().__init__(replace(config, run=""), exemplars)
        weights = {name: _as_array(tensor) for name, tensor in parts["generator"].items()}
        self.parts = {**parts, "generator": weights}
        self.local = LocalFractions.from_json(parts["fractions"]) if "fractions" in parts else None
        self.bias: PatternBias | None = parts.get("bias")
        self._network: Any = None
        self._device = "cpu"
        self._wanted: tuple[Request, np.ndarray] | None = None

    def matched_to(self, exemplar: Image) -> GanModel:
        """Return the same model, whose material ends with voxels that change phase until patterns
        are as frequent as in an exemplar: what a model that was trained before could not learn.

        Parameters
        ----------
        exemplar : Image of labels (Z, Y, X)
            What it learnt from, or more of that material; the same phases.

        Raises
        ------
        InputError
            An exemplar of other phases or with other labels, or one that tells no patterns: grey, a
            picture, too small, of more than three phases.
        """
        present = list(self.calibration.get("present", ()))
        if exemplar.kind != "labels" or np.unique(exemplar.values).tolist() != present:
            raise InputError(
                f"this model makes the labels {present}: give an exemplar of just these"
            )
        config = replace(self.config, interface_rounds=1)
        bias = learn_bias(self.network, config, exemplar, self.calibration, self.local)
        if bias is None:
            raise InputError(
                "the exemplar tells no patterns: give a volume of two or three phases, of at least "
                f"{LEAST_VOXELS * len(present) ** 8} voxels"
            )
        return self._varied(config, bias=bias)

    def unmatched(self) -> GanModel:
        """Return the same model, whose material stays as the generator makes it: as a page does in
        a browser. A last bit more or less then changes single voxels, and none around them.
        """
        return self._varied(replace(self.config, interface_rounds=0), bias=None)

    def _varied(self, config: GanConfig, **parts: Any) -> GanModel:
        """Return the same model with another config and some parts of its own."""
        found = GanModel(config, self.facts, {**self.parts, **parts})
        found.name, found._device = self.name, self._device
        return found

    def on(self, device: str) -> GanModel:
        """Return the same model, which makes material on a device.

        Parameters
        ----------
        device : {"cpu", "cuda", "auto"}
            A model that was trained or loaded makes material on the processor. A GPU is faster,
            and gives other values to a few voxels next to the threshold, from which other voxels
            of their tile may differ that change in the end; the recipe names it.

        Raises
        ------
        InputError
            PyTorch finds no GPU.
        """
        need("torch", extra="learn", purpose="method 'gan'")
        from trabecula.synth.gan.train import find_device

        found = self._varied(self.config)
        found._device = find_device(replace(self.config, device=device)).type
        return found

    @property
    def calibration(self) -> Mapping[str, Any]:
        """Return the calibration of `decode`."""
        found: Mapping[str, Any] = self.parts["calibration"]
        return found

    @property
    def channels(self) -> int:
        """Return the number of channels of the generator's output."""
        count = len(self.calibration.get("present", ()))
        return count if count > 2 else 1

    @property
    def _from_pictures(self) -> bool:
        return self.facts[0].ndim == 2

    @property
    def specks(self) -> int:
        """Return the edge of the components that are removed: grey has none."""
        return self.config.specks if self.calibration["kind"] == "labels" else 0

    @property
    def dtype(self) -> np.dtype:
        """Return the type of the values."""
        return np.dtype(self.calibration.get("dtype", "uint8"))

    @property
    def network(self) -> Any:
        """Return the generator: on the processor, whatever trained it, unless `on` says other."""
        if self._network is None:
            torch = need("torch", extra="learn", purpose="method 'gan'")
            from trabecula.synth.gan.networks import load_generator

            self._network = load_generator(
                self.config,
                self.channels,
                self.parts["generator"],
                torch.device(self._device),
            )
        return self._network

    def state(self) -> ModelState:
        """Return the weights, the calibration, the local fractions, the patterns and the history
        of the training; of pictures the spacing of the volume.
        """
        plain = {"calibration": self.calibration}
        plain |= {name: self.parts[name] for name in ("spacing", "fractions") if name in self.parts}
        plain |= {} if self.bias is None else {"patterns": self.bias.plain()}
        arrays = join_arrays(self.parts["generator"], self.bias)
        return ModelState(arrays, plain, dict(self.parts.get("training", {})))

    def browser_parts(self) -> tuple[dict[str, Any], np.ndarray]:
        """Return what makes the same labels in a page: settings as plain JSON, and weights.

        Returns
        -------
        settings : dict
            "name", "spacing", "unit", "phases", "shares" of what is made; "latent", "layers"
            (channels of output and input, and edge, of each convolution), "blurs", "channels" of
            the network; "fractions", what draws its local fractions, or None; "offsets",
            "present", "specks" of the labels.
        weights : (N,) float32
            Of every layer its biases, then its weights (output, input, z, y, x).

        Raises
        ------
        InputError
            A generator with padding, or grey values.
        """
        if self.config.generator != "subpixel" or self.calibration["kind"] != "labels":
            raise InputError(
                f"a page makes labels by the sub-pixel generator, the model {self.name or ''} has "
                f"generator={self.config.generator!r} and makes {self.calibration['kind']}: make "
                "its material with `trabecula generate --model`"
            )
        arrays = self.parts["generator"]
        layers = range(len(arrays) // 2)
        made = self._result_fields()
        settings = {
            "name": self.name,
            "spacing": [float(edge) for edge in made["spacing"]],
            "unit": made["unit"],
            "phases": list(made["phases"]),
            "shares": list(self.facts[0].shares),
            "latent": self.config.latent,
            "fractions": None if self.local is None else self.local.page_parts(),
            "layers": [list(arrays[f"layers.{i}.weight"].shape[:3]) for i in layers],
            "blurs": self.config.smoothing + self.config.polish,
            "channels": self.channels,
            "offsets": list(map(float, self.calibration["offsets"])),
            "present": list(map(int, self.calibration["present"])),
            "specks": self.specks,
        }
        flat = [arrays[f"layers.{i}.{part}"].ravel() for i in layers for part in ("bias", "weight")]
        return settings, np.concatenate(flat).astype(np.float32)

    def _result_fields(self) -> dict[str, Any]:
        found = super()._result_fields()
        return {**found, "spacing": tuple(self.parts.get("spacing", found["spacing"]))}

    def make_box(self, request: Request, box: Box) -> np.ndarray:
        within, places = _within_periods(request, box)
        cell = self.config.cell
        periods = tuple(
            side // cell if wraps else 0
            for side, wraps in zip(request.shape, request.periodic, strict=True)
        )
        made = make_tiles(
            self.network,
            key(request.seed, "gan/latent"),
            within,
            periods,
            partial(decode, calibration=self.calibration),
            self.dtype,
            specks=self.specks,
            given=self._given(request, within, periods),
            flips=self._flips(request),
        )
        return made if within == box else made[np.ix_(*places)]

    def _flips(self, request: Request) -> Flips | None:
        """Return what changes the tiles of a request in the end."""
        if self.bias is None:
            return None
        porosity, wanted = porosity_of(request.target), None
        if isinstance(porosity, np.ndarray):
            wanted = partial(self._fractions_around, request, porosity)
        return make_flips(self.bias, self.calibration, request.seed, wanted=wanted)

    def _fractions_around(
        self, request: Request, porosity: np.ndarray, tile: tuple[int, ...], around: int
    ) -> np.ndarray:
        """Return a target's fractions (Z, Y, X) of the second phase in a tile and around it; beyond
        a face that does not repeat the last are repeated.
        """
        edge = CELLS * self.config.cell
        inside = tuple(slice(place * edge, (place + 1) * edge) for place in tile)
        found, _ = tile_with_halo(porosity, inside, (around,) * 3, request.periodic)
        return found if self._void_is_higher() else 1 - found

    def _given(self, request: Request, box: Box, periods: tuple[int, ...]) -> Given | None:
        """Return what gives the generator its local fractions: a random field, or the target's."""
        if self.local is None:
            return None
        porosity = porosity_of(request.target)
        draw = partial(self.local.draw, key(request.seed, "gan/fractions"), periods=periods)
        if porosity is None:
            return draw
        field_in(porosity, box)  # which refuses a box that leaves the field
        if self._wanted is None or self._wanted[0] is not request:
            self._wanted = request, self._cells_of(porosity, request, draw)
        wanted = self._wanted[1]

        def given(corner: tuple[int, ...], sides: tuple[int, ...]) -> np.ndarray:
            places = [
                np.arange(first, first + side) % period
                if period
                else np.clip(np.arange(first, first + side), 0, length - 1)
                for first, side, period, length in zip(
                    corner, sides, periods, wanted.shape, strict=True
                )
            ]
            return wanted[np.ix_(*places)][None]

        return given

    def _cells_of(self, porosity: Target, request: Request, draw: Given) -> np.ndarray:
        """Return what to give each cell of a request, so that the target comes out: a field in
        every place, one number on average, around which fractions vary as they do without.
        """
        assert self.local is not None
        cell, wanted = self.config.cell, porosity
        if isinstance(porosity, np.ndarray):
            wanted = cell_means(porosity, cell, inside=request.mask)
        fraction = wanted if self._void_is_higher() else 1 - wanted
        if isinstance(fraction, np.ndarray) and not self._from_pictures:
            return self.local.given(fraction)
        sides = tuple(-(-side // cell) for side in request.shape)
        varied = draw((0, 0, 0), sides)[0]
        if self._from_pictures:  # it has seen no place of an even fraction
            return self.local.given(fraction) + (varied - varied.mean())
        inside = None if request.mask is None else cell_means(request.mask, cell)
        return self.local.around(varied, float(fraction), inside)

    def _void_is_higher(self) -> bool:
        """Tell whether the higher of the two labels is the void's."""
        void = self.facts[0].empty_label
        return bool(self.calibration["present"][1] == void)

    def _check_request(self, request: Request) -> None:
        super()._check_request(request)
        if request.target:
            self._check_porosity(request)
        cell = self.config.cell
        for side, wraps, axis in zip(request.shape, request.periodic, "zyx", strict=True):
            if wraps and side % cell:
                near = sorted({max(cell, side // cell * cell), -(-side // cell) * cell})
                raise RequestError(
                    f"this model repeats after multiples of {cell} voxels, the shape has {side} "
                    f"along {axis}: ask for {' or '.join(map(str, near))}, or leave {axis} out of "
                    "periodic"
                )

    def porosities(self) -> tuple[float, float] | None:
        """Return the least and greatest porosity that the generator makes where it is given the
        fractions of the exemplar's places; None where it takes no porosity.
        """
        void = self.facts[0].empty_label
        if self.local is None or not self.local.response.size:
            return None
        if void not in self.calibration["present"]:
            return None
        low, high = self.local.range
        return (low, high) if self._void_is_higher() else (1 - high, 1 - low)

    def _check_target(self, request: Request) -> None:
        """Accept what `_check_porosity` accepts, with exemplars or without."""

    def _check_porosity(self, request: Request) -> None:
        """Raise where the model takes no porosity, or not the one that is asked for."""
        found = self.porosities()
        if found is None:
            count = len(self.calibration.get("present", ()))
            why = "it learnt no local fractions"
            if self.local is not None:
                why = "it has no void" if count == 2 else f"it has {count} phases"
            raise RequestError(
                f"this model takes no target porosity: {why}; train one of labels of void and one "
                "other phase (fractions=1), or leave the target out"
            )
        low, high = found
        asked = np.asarray(porosity_of(request.target))
        asked = asked[request.mask] if request.mask is not None and asked.ndim else asked
        least, most = float(asked.min()), float(asked.max())
        if least < low - _SLACK or most > high + _SLACK:
            wanted = f"{least:.3g}" if least == most else f"{least:.3g} .. {most:.3g}"
            more = (
                "learn from a picture that has such places, or for longer"
                if self._from_pictures
                else "use method 'texture'"
            )
            raise RequestError(
                f"the target porosity {wanted} is outside of {low:.3g} .. {high:.3g}, which this "
                f"model makes: keep within it, or {more}"
            )

    def report_run(self) -> Mapping[str, Any]:
        """Return version and arithmetic: a few voxels near a threshold depend on both, and those
        that change in the end on these.
        """
        torch = need("torch", extra="learn", purpose="method 'gan'")
        from trabecula.synth.gan.networks import arithmetic

        found = {
            "torch": str(torch.__version__),
            "arithmetic": arithmetic(self.config, torch.device(self._device)),
        }
        return found if self._device == "cpu" else {**found, "device": self._device}

    def box_memory(self, request: Request, shape: tuple[int, ...]) -> Mapping[str, int]:
        need("torch", extra="learn", purpose="method 'gan'")
        from trabecula.synth.gan.networks import inference_bytes

        weights = sum(array.nbytes for array in self.parts["generator"].values())
        flips = self.bias is not None
        cells = CELLS + margin_cells(self.config.cell, specks=self.specks, flips=flips)
        edge = cells * self.config.cell
        made = (
            inference_bytes(self.config, self.channels, cells)
            if self._device == "cpu"
            else 2 * 4 * self.channels * edge**3  # the field on its way from the GPU
        )
        return {
            "interpreter and kernels": PROCESS,
            "exemplar": 2 * weights,
            "network": thread_count() * made,
            "tiles": thread_count() * 3 * edge**3 * self.dtype.itemsize + _LATENT,
            **({"patterns": thread_count() * LOCAL * edge**3} if flips else {}),
        }


def _within_periods(request: Request, box: Box) -> tuple[Box, list[np.ndarray]]:
    """Return the part of the period that a box is made of, and the places in it of its voxels: a
    box beyond a periodic axis repeats what lies within, whose tiles are others' neighbours.
    """
    within, places = [], []
    for (first, last), side, wraps in zip(box, request.shape, request.periodic, strict=True):
        voxels = np.arange(first, last)
        if wraps and (first < 0 or last > side):
            voxels %= side
        low, high = int(voxels.min()), int(voxels.max()) + 1
        within.append((low, high))
        places.append(voxels - low)
    return tuple(within), places


def build_model(
    config: GanConfig, facts: Sequence[ExemplarInfo], parts: Mapping[str, Any]
) -> GanModel:
    """Build the model of a file after checking its parts.

    Raises
    ------
    ValueError, TypeError, LookupError
        Not a generator's weights and calibration.
    MissingExtraError
        PyTorch is not installed.
    """
    calibration = parts["calibration"]
    grey = calibration["kind"] == "grey"
    if calibration["kind"] != facts[0].kind:
        raise ValueError(
            f"it is calibrated for {calibration['kind']!r}, its exemplar is {facts[0].kind}"
        )
    if grey:
        _check_table(calibration)
    else:
        _check_labels(calibration, len(facts[0].phases))
    if facts[0].ndim == 2:
        as_spacing(parts["spacing"], ndim=3)
    model = GanModel(config, facts, parts)
    _ = model.network  # which checks the weights
    return model


def _check_table(calibration: Mapping[str, Any]) -> None:
    dtype = np.dtype(calibration["dtype"])
    levels = [np.asarray(calibration[name], np.float64) for name in ("from", "to")]
    if dtype.kind not in "iuf" or any(level.ndim != 1 or len(level) < 2 for level in levels):
        raise ValueError("its calibration of grey values is damaged")
    if len(levels[0]) != len(levels[1]) or not all(np.isfinite(level).all() for level in levels):
        raise ValueError("its calibration of grey values is damaged")


def _check_labels(calibration: Mapping[str, Any], phases: int) -> None:
    present = [int(label) for label in calibration["present"]]
    offsets = np.asarray(calibration["offsets"], np.float64)
    rising = (
        present == sorted(set(present))
        and len(present) >= 2
        and present[0] >= 0
        and present[-1] < phases
    )
    if (
        not rising
        or offsets.shape != (len(present) if len(present) > 2 else 1,)
        or not np.isfinite(offsets).all()
    ):
        raise ValueError(f"its calibration of the phases {present} is damaged")


def _as_array(tensor: Any) -> np.ndarray:
    return tensor if isinstance(tensor, np.ndarray) else tensor.detach().cpu().numpy()
