"""Settings of the flow: a part of those of `bubbles`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from trabecula.core.checks import as_number, check_name
from trabecula.core.errors import InputError
from trabecula.synth.bubbles.flow.given import as_given
from trabecula.synth.bubbles.flow.slices import CENTRES, ORDER
from trabecula.synth.bubbles.flow.systems import NONE, condition_of, system_of


@dataclass(frozen=True)
class FlowConfig:
    """Direction of the bubbles, and the crust without bubbles."""

    flow: Any = "none"
    """What bubbles stretch along: "none"; a system by name: concentric, elliptic, spiral, roll,
    radial, saddle, quadratic (equation 3), horizontal, vertical, axial; two formulas "x', y'" of x
    and y in a slice (and z along the axis), or three "x', y', z'" of the volume; a .npy file of
    vectors (Z, Y, X, 3) along z, y, x that spans what is made, or in Python such an array, or a
    function of z, y, x that returns three arrays."""

    flow_axis: str = "z"
    """The principal axis, z, y or x: slices lie across it. In a slice x runs along the last of its
    axes and y along the other. Of a picture there is one slice."""

    flow_centre: str = "slice"
    """Where x and y are 0: "slice", at the centre of mass of each slice of the mask; "piece", at
    that of the part of the slice, where parts do not touch; "box", in the middle of what is made,
    as always without a mask."""

    flow_extent: float = 1.0
    """What x, y and z are at half the longest side of a slice (of the volume, for three formulas,
    functions and regions), 1e-6 .. 1e6; 0: they are lengths, in the unit of the voxels."""

    flow_regions: tuple[tuple[str, Any], ...] = ()
    """Other flows in parts of the volume: pairs of a condition on x, y, z of the volume and
    `label`, and a flow, such as [["z > 0.5", "radial"], ["label == 2", "none"]]; the first that
    holds counts, and `flow` where none does."""

    flow_labels: Any = None
    """What `label` is: a file of labels that spans what is made, or in Python an array or Image.
    Without: 0.
    """

    flow_aspect: float = 0.0
    """Ratio from which a slice counts as wide or tall, 1 .. 100: wide ones then flow horizontally,
    tall ones vertically, the others as `flow` says. 0: the shape of a slice does not matter."""

    silhouette: float | None = None
    """How far from its border a slice of the mask makes bubbles follow the outline, in the unit of
    the voxels: the size of the paper's blur. Default: `silhouette_share`."""

    silhouette_share: float = 0.0
    """The same in mean distances between bubbles, 0 .. 100."""

    crust: float | None = None
    """Depth below the mask's surface in which no bubble grows, in the unit of the voxels. Default:
    `crust_share`.
    """

    crust_share: float = 0.0
    """The same in mean distances between bubbles, 0 .. 100."""

    def __post_init__(self) -> None:
        self._keep("flow", as_flow(self.flow, name="flow"))
        check_name(self.flow_axis, ORDER, name="flow_axis")
        check_name(self.flow_centre, CENTRES, name="flow_centre")
        if self.flow_extent != 0:
            self._keep(
                "flow_extent", as_number(self.flow_extent, name="flow_extent", low=1e-6, high=1e6)
            )
        if self.flow_aspect != 0:
            self._keep(
                "flow_aspect", as_number(self.flow_aspect, name="flow_aspect", low=1, high=100)
            )
        self._keep("flow_regions", _as_regions(self.flow_regions))
        self._keep("flow_labels", _as_labels(self.flow_labels))
        for name in ("silhouette", "crust"):
            share = f"{name}_share"
            self._keep(share, as_number(getattr(self, share), name=share, low=0, high=100))
            if getattr(self, name) is not None:
                self._keep(name, as_number(getattr(self, name), name=name, low=0, high=1e20))

    def _keep(self, name: str, value: Any) -> None:
        """Set a checked value."""
        object.__setattr__(self, name, value)

    def has_direction(self, *, masked: bool) -> bool:
        """Return whether a request, with a mask or without, has a direction anywhere."""
        flows = [self.flow, *(flow for _, flow in self.flow_regions)]
        outlined = masked and self.flow_length("silhouette", distance=1.0) > 0
        return bool(self.flow_aspect) or outlined or any(flow != NONE for flow in flows)

    def flow_length(self, name: str, distance: float) -> float:
        """Return `silhouette` or `crust` as a length, where bubbles are `distance` apart."""
        given = getattr(self, name)
        return float(getattr(self, f"{name}_share") * distance if given is None else given)


def as_flow(value: Any, *, name: str) -> str:
    """Check a flow: plain text, or text that carries an array or a function."""
    found = as_given(value, name=name)
    flow = value if found is None else found
    system_of(flow, name=name)
    return flow


def _as_regions(value: Any) -> tuple[tuple[str, str], ...]:
    """Check pairs of a condition and a flow."""
    pairs = tuple(value) if isinstance(value, (list, tuple)) else None
    if pairs is None or not all(
        isinstance(pair, (list, tuple)) and len(pair) == 2 for pair in pairs
    ):
        raise InputError(
            f"flow_regions={value!r} should be pairs of a condition and a flow, [['z > 0', "
            "'radial'], ...]"
        )
    for where, _ in pairs:
        condition_of(where)
    return tuple((where, as_flow(flow, name=f"the flow where {where}")) for where, flow in pairs)


def _as_labels(value: Any) -> str | None:
    """Check an array of labels, or a file of them."""
    if value is None:
        return None
    given = as_given(value, name="flow_labels")
    if given is None or given.array is None:
        raise InputError(f"flow_labels={value!r} should be a file of labels, an array or an Image")
    if given.array.dtype.kind not in "biu" or given.array.ndim not in (2, 3):
        raise InputError(
            f"flow_labels holds {given.array.dtype} of shape {given.array.shape}: give whole "
            "numbers, (Z, Y, X) or (Y, X)"
        )
    return given
