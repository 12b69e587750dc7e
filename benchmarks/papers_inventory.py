"""Every numbered table and figure of the five papers: what it shows, and where the answer is."""

from __future__ import annotations

from dataclasses import dataclass

MEASURED, DRAWN, DIAGRAM = "measured", "drawn", "diagram"
NOT_MEASURED, NOT_COMPARABLE = "not measured", "not comparable"
STATES = (MEASURED, DRAWN, DIAGRAM, NOT_MEASURED, NOT_COMPARABLE)


@dataclass(frozen=True)
class Item:
    """A table or a figure of a paper."""

    name: str
    shows: str
    state: str
    """`measured` and `drawn`: by the runs; `diagram`: of the method, nothing to measure."""
    runs: tuple[str, ...] = ()
    note: str = ""
    """Where else the answer is, or why there is none."""


@dataclass(frozen=True)
class Paper:
    """A paper, its method here, and what it numbers."""

    key: str
    title: str
    method: str
    figures: int
    tables: int
    items: tuple[Item, ...]


PAPERS = (
    Paper(
        "2017",
        "Zhang, Chen, Wang, Wang 2017, By example synthesis of three-dimensional porous materials",
        "texture",
        16,
        1,
        (
            Item("section 5.1", "20 minutes for 120^3 from 60^3", MEASURED, ("weights",)),
            Item(
                "table 1",
                "two-point function against rivals",
                MEASURED,
                ("by_example_2017", "iso_value"),
            ),
            Item("figure 1", "flow chart", DIAGRAM),
            Item("figure 2", "neighbourhoods", DIAGRAM),
            Item("figure 3", "pruning, in principle", DIAGRAM, note="`finish.prune`"),
            Item("figure 4", "thinning", DIAGRAM, note="`finish.prune` thins in the same way"),
            Item("figure 5", "energy with and without adaptive weights", MEASURED, ("weights",)),
            Item("figure 6", "two results; 5 and 2 prunings", MEASURED, ("by_example_2017",)),
            Item(
                "figure 7",
                "foam in free forms; 7, 9, 3, 2 prunings",
                DRAWN,
                ("stills",),
                "another form: its meshes are not at hand",
            ),
            Item("figure 8", "blur without adaptive weights", MEASURED, ("weights",)),
            Item("figure 9", "repeated on its own result", MEASURED, ("repeat", "repeat_paper")),
            Item("figure 10", "beside Chen and Kopf", DRAWN, ("by_example_2017",)),
            Item(
                "figure 11",
                "two-point functions",
                MEASURED,
                ("by_example_2017", "by_example_2021"),
                "their distances are table 1; curves: figure 12 of 2021",
            ),
            Item("figure 12", "histogram of grey values", MEASURED, ("histogram",)),
            Item("figure 13", "smoothed and thickened", DRAWN, ("stills",)),
            Item("figure 14", "printed (SLS)", NOT_COMPARABLE, note="no printer here"),
            Item("figure 15", "printed (SLA)", NOT_COMPARABLE, note="no printer here"),
            Item(
                "figure 16",
                "printed (FDM)",
                NOT_COMPARABLE,
                note="no printer here; `trabecula check` tells what a printer would refuse",
            ),
        ),
    ),
    Paper(
        "2021",
        "Zhang, Yang, Li, Wu, Wang 2021, ScaffoldGAN",
        "gan",
        15,
        3,
        (
            Item(
                "table 1",
                "eight methods on bone and foam",
                MEASURED,
                ("by_example_2021", "by_example_2017", "gan_shipped", "gan_speed", "gan_paper"),
                "the network of full width: a tenth of the iterations, of fewer crops",
            ),
            Item(
                "table 2",
                "five bones",
                MEASURED,
                ("gan_losses",),
                "at a width that trains on a processor, on bones of ours; not at the paper's",
            ),
            Item(
                "table 3",
                "four stones, two foams",
                MEASURED,
                ("gan_shipped", "by_example_2017", "gan_losses"),
                "the paper's scans are not at hand: other stones and another foam stand in, "
                "and for the losses a width that trains on a processor",
            ),
            Item("figure 1", "the scan and its regions", DIAGRAM),
            Item("figure 2", "the networks", DIAGRAM),
            Item("figure 3", "regions of feature maps", DIAGRAM),
            Item("figure 4", "feature maps", DIAGRAM),
            Item(
                "figure 5",
                "training curve over 40,000 iterations",
                DRAWN,
                ("gan_paper",),
                "over 3,944 of 16 crops; the whole is about 95 minutes of an H200",
            ),
            Item("figure 6", "a foam from three sides", DRAWN, ("stills",), "from one side"),
            Item("figure 7", "beside other methods", DRAWN, ("by_example_2021", "gan_shipped")),
            Item("figure 8", "three samples differ", MEASURED, ("gan_shipped",)),
            Item("figure 9", "420^3 of bones", MEASURED, ("gan_speed",)),
            Item("figure 10", "420^3 from outside", MEASURED, ("gan_speed",)),
            Item("figure 11", "sections of 420^3", DRAWN, ("gan_shipped",), "of 120^3"),
            Item(
                "figure 12",
                "two-point functions",
                MEASURED,
                ("by_example_2021",),
                "their distances are table 1",
            ),
            Item(
                "figure 13",
                "weights of the losses from .01 to 10",
                NOT_MEASURED,
                note="eight trainings at full width are half a day of a GPU; at width 8, by 120 "
                "and 360 iterations: [the card](../methods/gan.md)",
            ),
            Item(
                "figure 14",
                "stones beside other methods",
                NOT_COMPARABLE,
                note="the paper's scans are not at hand; numbers of others: table 3",
            ),
            Item("figure 15", "printed (resin)", NOT_COMPARABLE, note="no printer here"),
        ),
    ),
    Paper(
        "2014",
        "Urs, Da Costa, Germain 2014, Maximum-likelihood based synthesis of volumetric textures",
        "mrf",
        12,
        0,
        (
            Item("section VI", "48 hours for 64^3 in colour", MEASURED, ("colour",)),
            Item("figure 1", "the algorithm", DIAGRAM),
            Item("figure 2", "neighbourhoods in three views", DIAGRAM),
            Item("figure 3", "the heuristics, in principle", DIAGRAM),
            Item("figure 4", "four heuristics, ICM", MEASURED, ("heuristics",)),
            Item("figure 5", "cooling and stop: 18 to 6 iterations", MEASURED, ("cooling",)),
            Item("figure 6", "up-sampling and neighbourhood", MEASURED, ("upsampling",)),
            Item("figure 7", "ICM beside annealing", MEASURED, ("relaxations",)),
            Item("figure 8", "colour", DRAWN, ("colour",)),
            Item("figure 9", "fifteen textures beside Kopf", DRAWN, ("indicators",)),
            Item(
                "figure 10",
                "three indicators of fifteen textures",
                MEASURED,
                ("indicators",),
                "bars without numbers; other textures",
            ),
            Item("figure 11", "two views and three", MEASURED, ("views",)),
            Item("figure 12", "the same as volumes", DRAWN, ("views",)),
        ),
    ),
    Paper(
        "Liu 2016",
        "Liu, Shapiro 2016, Sample-based design of functionally graded material structures",
        "quilt",
        9,
        2,
        (
            Item("table 1", "repair of a section of bone", MEASURED, ("section",)),
            Item("table 2", "graded lattices", MEASURED, ("lattice",)),
            Item("figure 1", "the problem", DIAGRAM),
            Item("figure 2", "neighbourhoods", DIAGRAM),
            Item("figure 3", "descriptors", DIAGRAM),
            Item("figure 4", "patches and overlaps", DIAGRAM),
            Item("figure 5", "a section made again; 3.4 s", MEASURED, ("section",)),
            Item("figure 6", "a removed region made again", MEASURED, ("section",)),
            Item("figure 7", "cantilever; about 90 minutes", MEASURED, ("lattice",)),
            Item("figure 8", "cells chosen by Euler number", MEASURED, ("lattice", "cells")),
            Item("figure 9", "wheel", MEASURED, ("lattice",)),
        ),
    ),
    Paper(
        "Baravalle 2016",
        "Baravalle, Scandolo, Delrieux, García Bauza, Eisemann 2016, Realistic modeling of porous "
        "materials",
        "bubbles",
        14,
        1,
        (
            Item("table 1", "seconds and memory", MEASURED, ("bubbles",)),
            Item("figure 1", "separation 1, 2, 4", DRAWN, ("bubble_figures",)),
            Item("figure 2", "dynamical systems", DRAWN, ("bubble_figures",)),
            Item("figure 3", "randomness .3, .2, .1", DRAWN, ("bubble_figures",)),
            Item("figure 4", "vectors along a silhouette", DRAWN, ("bubble_figures",)),
            Item("figure 5", "slices: boundary and flow", DRAWN, ("bubble_figures",)),
            Item("figure 6", "flow by the slice's ratio", DRAWN, ("bubble_figures",)),
            Item("figure 7", "slices of a form", DRAWN, ("bubble_figures",)),
            Item(
                "figure 8",
                "the viewer",
                NOT_COMPARABLE,
                note="an application on its graphics card; ours is a page: "
                "[figures](figures.md#pictures)",
            ),
            Item("figure 9", "sponges", DRAWN, ("bubble_stills",)),
            Item("figure 10", "stones", DRAWN, ("bubble_stills",)),
            Item("figure 11", "white and Perlin noise", DRAWN, ("bubble_stills",)),
            Item("figure 12", "Voronoi and Worley noise", DRAWN, ("bubble_stills",)),
            Item("figure 13", "breads about a centre", DRAWN, ("bubble_stills",)),
            Item("figure 14", "breads", DRAWN, ("bubble_stills",)),
        ),
    ),
)
