"""The tables: `make bench`, `trabecula bench [CASE ...]`, or `python benchmarks/run.py [CASE ...]`.

A word stands for every case that begins so: `texture` for all of that method's. `--list` names
them.

Cases are frozen: exemplar, crop, shape and seeds stay as they are, so that figures can be compared
over time. Seconds are of one thread with kernels compiled, and stand beside the time of a fixed
NumPy job in the same run (`unit`), so that machines can be compared too. Quality comes from
`trabecula.measure` and `verify` alone.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable

import big
import big_scaling
import big_whole
import bubbles
import bubbles_figures
import bubbles_fit
import by_example
import closed_cells
import conduction
import drainage
import ensemble_rates
import ensembles
import evenness
import forms
import fusion
import gan
import gan_ablation
import gan_paper
import gan_weights
import graded
import graded_bone
import graded_materials
import image
import image_cells
import image_figures
import image_paper
import image_processes
import image_speed
import image_truth
import intervals
import joints
import networks
import noise
import novelty_blind
import oriented
import packing
import papers
import photographs
import printing
import properties
import scan
import sections
import stills
import texture
import texture_figures
import texture_grey
import texture_speed
import trabecula as tb
import trends
import view
import view_peers
import zoo
from common import tell, timed, unit
from descriptors import certificate, descriptors, large
from trabecula.cli.terminal import fail, show_rows
from trabecula.core.checks import check_name
from trabecula.core.errors import TrabeculaError
from trabecula.measure.distance import distance_transform


def measures() -> None:
    """Seconds of every descriptor of a volume of 160^3, beside the fixed job."""
    volume = tb.method("texture").fit(tb.crop(tb.sample("bone"), 60)).generate(160, seed=0)
    base = unit()
    jobs: dict[str, Callable[[], object]] = {
        "two_point, r = 50": lambda: tb.measure.two_point(volume, r_max=50),
        "lineal_path, r = 50": lambda: tb.measure.lineal_path(volume, r_max=50),
        "components": lambda: tb.measure.components(volume),
        "minkowski": lambda: tb.measure.minkowski(volume),
        "distance_transform": lambda: distance_transform(volume.values > 0),
        "thickness": lambda: tb.measure.thickness(volume),
        "pore_size": lambda: tb.measure.pore_size(volume),
        "describe": lambda: tb.describe(volume),
        "connect": lambda: tb.finish.connect(volume),
        "mesh": lambda: tb.mesh(volume),
        "render 800 x 600": lambda: tb.render(volume),
    }
    tell("job at 160^3", "s", "/ unit")
    for name, job in jobs.items():
        job()
        seconds = min(timed(job)[0] for _ in range(3))
        tell(name, f"{seconds:.3f}", f"{seconds / base:.1f}")


CASES: dict[str, Callable[[], None]] = {
    "scan": scan.segmenters,
    "texture_fidelity": texture.fidelity,
    "texture_materials": texture.materials,
    "texture_crops": texture.crops,
    "texture_novelty": texture.novelty,
    "texture_repeat": texture.repeat,
    "texture_energy": texture.energy,
    "texture_paper": texture.paper,
    "texture_repeat_paper": texture.repeat_paper,
    "texture_weights": texture_figures.texture_weights,
    "texture_iso_value": texture_figures.texture_iso_value,
    "texture_histogram": texture_figures.texture_histogram,
    "texture_grey": texture_grey.texture_grey,
    "texture_joints": joints.texture_joints,
    "texture_grey_joints": joints.texture_grey_joints,
    "packing_joints": joints.packing_joints,
    "texture_forms": forms.texture_forms,
    "packing": packing.packing,
    "fibres": packing.fibres,
    "by_example_2017": by_example.by_example_2017,
    "by_example_2021": by_example.by_example_2021,
    "evenness": evenness.evenness_table,
    "texture_speed": texture_speed.speed,
    "texture_sizes": texture_speed.sizes,
    "gan_models": gan.models,
    "gan_populations": gan.populations,
    "gan_pictures": gan.from_pictures,
    "gan_shipped": gan.shipped,
    "gan_speed": gan.speed,
    "gan_ablation": gan_ablation.ablation,
    "gan_losses": gan_ablation.materials,
    "gan_smoke": gan.smoke,
    "gan_paper": gan_paper.gan_paper,
    "gan_weights": gan_weights.gan_weights,
    "image_likeness": image.image_likeness,
    "image_cells": image_cells.image_cells,
    "closed_cells": closed_cells.closed_cells,
    "sections": sections.sections,
    "section_verdicts": sections.section_verdicts,
    "section_volumes": sections.section_volumes,
    "image_paper": image_paper.image_paper,
    "image_cooling": image_figures.image_cooling,
    "image_upsampling": image_figures.image_upsampling,
    "image_relaxations": image_figures.image_relaxations,
    "image_colour": image_figures.image_colour,
    "image_views": image_figures.image_views,
    "image_truth": image_truth.image_truth,
    "image_processes": image_processes.image_processes,
    "image_speed": image_speed.image_speed,
    "fusion": fusion.fusion,
    "fusion_slices": fusion.fusion_slices,
    "graded_lattice": graded.graded_lattice,
    "graded_cells": graded.graded_cells,
    "graded_section": graded.graded_section,
    "graded_bone": graded.graded_bone,
    "graded_materials": graded_materials.graded_materials,
    "graded_bone_fields": graded_bone.graded_bone_fields,
    "graded_bone_copies": graded_bone.graded_bone_copies,
    "graded_bone_stiffness": graded_bone.graded_bone_stiffness,
    "graded_bone_moduli": graded_bone.graded_bone_moduli,
    "graded_seams": graded.graded_seams,
    "graded_speed": graded.graded_speed,
    "oriented": oriented.oriented,
    "design": oriented.design,
    "design_bone": oriented.design_bone,
    "bubbles_fit": bubbles_fit.bubbles_fit,
    "noise": noise.noise,
    "bubbles_table": bubbles.bubbles_table,
    "bubbles_grids": bubbles.bubbles_grids,
    "bubbles_porosity": bubbles.bubbles_porosity,
    "bubbles_threads": bubbles.bubbles_threads,
    "bubbles_figures": bubbles_figures.bubbles_figures,
    "big_blocks": big.big_blocks,
    "big_kills": big.big_kills,
    "big_workers": big.big_workers,
    "big_scaling": big_scaling.big_scaling,
    "big_whole": big_whole.big_whole,
    "properties": properties.properties,
    "property_fields": properties.property_fields,
    "window_properties": properties.window_properties,
    "papers": papers.papers,
    "view_still": view.view_still,
    "view_page": view.view_page,
    "view_large": view.view_large,
    "view_peers": view_peers.view_peers,
    "stills": stills.stills,
    "stills_noise": stills.stills_noise,
    "photographs": photographs.photographs,
    "surfaces": printing.surfaces,
    "layers": printing.layers,
    "intervals": intervals.intervals,
    "conduction": conduction.conduction,
    "drainage": drainage.drainage,
    "drainage_tubes": drainage.drainage_tubes,
    "networks": networks.networks,
    "measures": measures,
    "large": large,
    "descriptors": descriptors,
    "certificate": certificate,
    "zoo": zoo.zoo,
    "ensembles": ensembles.ensembles,
    "trends": trends.trends,
    "novelty_blind": novelty_blind.novelty_blind,
    "ensemble_rates": ensemble_rates.ensemble_rates,
}


def chosen(words: list[str]) -> list[str]:
    """The cases that these words stand for, all where there is none.

    Raises
    ------
    UnknownNameError
        A word that no case begins with.
    """
    found: list[str] = []
    for word in words:
        several = [name for name in CASES if word and name.startswith(word)]
        if not several:
            check_name(word, CASES, name="case")
        found += several
    return list(dict.fromkeys(found)) or list(CASES)


def main(words: list[str]) -> int:
    """Run the cases, or list them; returns the exit status."""
    try:
        names = chosen([word for word in words if word != "--list"])
    except TrabeculaError as error:
        fail(str(error))
        return 2
    if "--list" in words:
        show_rows([(name, _summary(name)) for name in names])
        return 0
    try:
        with tb.threads(1):
            for name in names:
                print(f"\n## {name}: {inspect.getdoc(CASES[name])}\n", flush=True)
                CASES[name]()
    except KeyboardInterrupt:
        return 130
    except TrabeculaError as error:
        fail(str(error))
        return 2
    return 0


def _summary(name: str) -> str:
    return (inspect.getdoc(CASES[name]) or "").partition("\n")[0]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
