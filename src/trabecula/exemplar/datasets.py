"""Published scans and pictures by name: where each is, its licence, and the hash of its voxels.

The hashes are of voxels, not of files, so that a copy in another format counts as well: they were
taken from copies in a folder. The addresses were put together from the public listing of each
repository and have not been fetched; what comes from one is used only if its voxels have the hash.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

__all__ = ["DATA_SETS", "DataSet", "datasets"]

_RAW = "https://raw.githubusercontent.com"
_VOID_SOLID = ("void", "solid")


@dataclass(frozen=True)
class DataSet:
    """A published scan or picture.

    Attributes
    ----------
    name, summary : str
    file : str
        Name of a copy in a folder of data.
    sha256 : str
        Of type, shape and voxels as read, cropped.
    shape : tuple of int
        (z, y, x), or (y, x); a larger file is cropped to it from its first voxel on.
    kind : str
        labels, grey or colour.
    spacing, unit : float and str
        Voxel edge; 1 "voxel" where the source states none.
    phases : tuple of str
        Names of labels.
    licence, source : str
        The source's licence; its repository or package, and the path there.
    address : str
        Of the file itself; empty where the source is an archive, a folder of slices or a package.
    """

    name: str
    summary: str
    file: str
    sha256: str
    shape: tuple[int, ...]
    kind: str
    licence: str
    source: str
    address: str = ""
    spacing: float = 1.0
    unit: str = "voxel"
    phases: tuple[str, ...] = ()


def _github(repository: str, commit: str, path: str) -> dict[str, Any]:
    """Return source and address of a file at a commit."""
    return {
        "source": f"github.com/{repository}: {path}",
        "address": f"{_RAW}/{repository}/{commit}/{quote(path)}",
    }


def _bone(number: int) -> dict[str, Any]:
    path = f"data/rois/isodata_04216_roi_{number}.nrrd"
    return _github("qiancao/BoneBox", "3024b412b99bcc4bf5333416b8625dcd71dfddb3", path)


def _micrograph(name: str) -> dict[str, Any]:
    path = f"example_microstructures/{name}_resized.npy"
    commit = "7d5312f4f55c720acc59b2f8faf72f25f4055acc"
    return _github("NEFM-TUDresden/MCRpy", commit, path)


def _bread(number: int) -> dict[str, Any]:
    path = f"images/train/bread/baguette{number}.png"
    return _github("rbaravalle/imfractal", "418ee94b7739f016e626a7d27dc0bcff6eb26c45", path)


def _super_resolution(path: str) -> dict[str, Any]:
    return _github("amirDahari1/SuperRes", "b8e1a1ebcedc306ee23bc3f1fd7193a00bcf07fa", path)


_BONE: dict[str, Any] = {"kind": "labels", "spacing": 0.05, "unit": "mm", "phases": _VOID_SOLID}
_BONEBOX = "BSD-3-Clause (BoneBox)"
_LI = "CC-BY-4.0 (Li et al. 2018, Scientific Reports; through MCRpy)"

DATA_SETS = {
    one.name: one
    for one in (
        DataSet(
            "bone",
            "human trabecular bone, interior, segmented micro-CT",
            "trabecular_bone_a.tif",
            "67777105a337b561c5cdfd6bef55b19c790c907f2a1395e9713ba6306c8ad676",
            (201, 201, 201),
            licence=_BONEBOX,
            **_bone(4),
            **_BONE,
        ),
        DataSet(
            "bone-sparse",
            "human trabecular bone, sparser, segmented micro-CT",
            "trabecular_bone_b.tif",
            "39cb2700fba22bfc472dc1a14eb889c90252c05684cc789960a92e60d75e1df1",
            (201, 201, 201),
            licence=_BONEBOX,
            **_bone(1),
            **_BONE,
        ),
        DataSet(
            "bone-cortex",
            "human trabecular bone with its cortical shell, segmented micro-CT",
            "trabecular_bone_cortex_a.tif",
            "cc6a91becd6d2e5cf82f6b4c7aaa1f79b05b814f18d3bf92ca627b98c39424ad",
            (201, 201, 201),
            licence=_BONEBOX,
            **_bone(0),
            **_BONE,
        ),
        DataSet(
            "bone-grey",
            "human trabecular bone, grey micro-CT",
            "trabecular_bone_grey_lhdl.tif",
            "8662ddecf457f36d77f43605619f798fcae0dccd7c0e83699c7a44023906220b",
            (160, 160, 160),
            "grey",
            "MIT (ciclope); data of the LHDL collection",
            "github.com/gianthk/ciclope: test_data/LHDL/3155_D_4_bc/cropped, 160^3 of its slices",
            spacing=19.5,
            unit="um",
        ),
        DataSet(
            "berea",
            "Berea sandstone, segmented micro-CT; voxel size not stated",
            "berea_sandstone_a.tif",
            "6542f3930c112db08ab23d68a56c4224ec6b5723179c0d9c6754be5a35004ecc",
            (200, 200, 200),
            "labels",
            "MIT (PorousMediaGan); data of Imperial College London",
            "github.com/LukasMosser/PorousMediaGan: data/berea/original/raw/berea.zip, its first "
            "200^3 voxels",
            phases=_VOID_SOLID,
        ),
        DataSet(
            "cathode",
            "NMC cathode of a battery, segmented micro-CT, binder counted as void",
            "nmc_electrode_a.tif",
            "0df124b41bb3f16dd4ce2ceefaac36a1dc407e730f0c3b45af137f47b8e894dd",
            (125, 150, 301),
            "labels",
            "BSD-3-Clause (MATBOX)",
            "github.com/NREL/MATBOX_Microstructure_analysis_toolbox: Data_example/From computed "
            "tomography with additives numerically generated/nmc-1-cal_generatedCBD_bridge.tif, "
            "its first 125 x 150 x 301 voxels, generated binder merged into the void",
            phases=_VOID_SOLID,
        ),
        DataSet(
            "electrode",
            "electrode of three phases, named by their look; may be a generated volume",
            "electrode_3phase_a.tif",
            "b4d9fc553b84557f2061504ad4eebcf3ca972e673ca170d11fa68e62fe7d5e56",
            (128, 256, 256),
            "labels",
            "MIT (taufactor)",
            **_github(
                "tldr-group/taufactor",
                "4d26e7e57814f576fd68f23855b8029d238e8076",
                "docs/notebooks/electrode.tiff",
            ),
            phases=("void", "active", "binder"),
        ),
        DataSet(
            "cathode-coarse",
            "particles of a battery's cathode at low resolution, segmented",
            "battery_cathode_lowres.tif",
            "d867892641f9ab201461e770e68b42022aed53f20b96d715494173e37c7148fe",
            (128, 128, 128),
            "labels",
            "MIT (SuperRes)",
            **_super_resolution("data/NMC_lr_input.tif"),
            phases=_VOID_SOLID,
        ),
        DataSet(
            "fibres",
            "scaffold of polymer fibres, grey micro-CT",
            "polymer_fibres.tif",
            "c7ed5ffbe182e77c6e968a89cd20fb02d8f1ef344fc069fd93e709e28b4a41fd",
            (128, 128, 128),
            "grey",
            "MIT (quanfima)",
            "github.com/rshkarin/quanfima: data/polymer3d_8bit_128x128x128.raw",
        ),
        DataSet(
            "cement",
            "cement paste with air voids, grey micro-CT",
            "cement_air_voids.tif",
            "6c712b71e77a2e30c78466b2967c671f7de73fcda1bc0f9439eac9854930812a",
            (128, 128, 128),
            "grey",
            "MIT (qim3d)",
            "the package qim3d 1.5.3: qim3d/examples/cement_128x128x128.tif",
        ),
        DataSet(
            "micrograph-sandstone",
            "section of a sandstone, segmented; the brighter phase is very likely the void",
            "micrograph_sandstone.png",
            "c054f18b8bacebb5e0675c8aa3f9b5a73e71788bc2039f4719b88d91f4023e8c",
            (256, 256),
            "labels",
            _LI,
            **_micrograph("sandstone"),
            phases=("solid", "void"),
        ),
        DataSet(
            "micrograph-ceramics",
            "section of a ceramic, segmented",
            "micrograph_ceramics.png",
            "825ed467e7d893a82b11e6ce750f3c0a8df7d684d6befb335ef52e898143bc99",
            (256, 256),
            "labels",
            _LI,
            **_micrograph("ceramics"),
            phases=_VOID_SOLID,
        ),
        DataSet(
            "micrograph-copolymer",
            "section of a copolymer, segmented",
            "micrograph_copolymer.png",
            "ce38d0a0b8952062b94c34fdc3a06107dbde1045c3912a88046f8d13e91d66f9",
            (256, 256),
            "labels",
            _LI,
            **_micrograph("copolymer"),
            phases=_VOID_SOLID,
        ),
        DataSet(
            "baguette",
            "crumb of a baguette, colour photograph",
            "bread_baguette2.png",
            "d6dc7afc3f14b46d69d48b62939f4cc96ca2f43623b3bdaec8e8545d0f6b8004",
            (380, 380),
            "colour",
            "BSD (imfractal)",
            **_bread(2),
        ),
        DataSet(
            "baguette-open",
            "crumb of another baguette, colour photograph",
            "bread_baguette8.png",
            "1ff0436a919f28f78881595cde15b714412638c2beae6d102e3d55db16770192",
            (380, 380),
            "colour",
            "BSD (imfractal)",
            **_bread(8),
        ),
        DataSet(
            "separator",
            "separator of a battery, section across its stretch, segmented",
            "separator_speckles_2d.png",
            "d1a85797d5e1cc7b6b58be70174ec035edd9aab09522f1382db027c4d570e10c",
            (300, 300),
            "labels",
            "MIT (SuperRes)",
            "github.com/amirDahari1/SuperRes: data/Separator_hr_input_speckles.tif, slice 3",
            phases=_VOID_SOLID,
        ),
    )
}


def datasets() -> dict[str, Any]:
    """Return the names of the published data sets that `fetch` takes, and a summary of each."""
    return {name: one.summary for name, one in DATA_SETS.items()}
