"""Tables and figures of Zhang, Yang, Li, Wu, Wang (2021), `gan`."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

from gan_ablation import MATERIALS as MATERIALS_OF_LOSSES
from papers_rows import LESS, Row, Section, spread
from papers_saved import Saved, load

BONE = {
    "Kopf": ("20.27", "43.39", "268/159", "1922"),
    "Chen": ("13.78", "32.39", "116/106", "2164"),
    "Zhang 2017": ("2.86", "8.97", "20/11", "1441"),
    "baseline GAN": ("1.51", "5.95", "40/17", "0.094"),
    "PatchGAN": ("1.49", "5.83", "30/23", "0.095"),
    "GAN + gram": ("1.16", "5.79", "26/19", "0.095"),
    "GAN + structural": ("0.71", "3.27", "8/5", "0.096"),
    "all (ScaffoldGAN)": ("0.59", "3.05", "6/3", "0.096"),
}
FOAM = {
    "Kopf": ("10.07", "44.88", "878/121", ""),
    "Chen": ("3.77", "36.91", "158/74", ""),
    "Zhang 2017": ("2.11", "13.67", "22/13", ""),
    "baseline GAN": ("2.02", "18.30", "28/8", ""),
    "PatchGAN": ("1.89", "16.31", "34/14", ""),
    "GAN + gram": ("1.70", "15.39", "17/9", ""),
    "GAN + structural": ("0.85", "6.11", "8/4", ""),
    "all (ScaffoldGAN)": ("0.73", "5.23", "6/3", ""),
}
"""Table 1: porosity error in per cent, D2, N_cc / N_f, seconds."""

OURS = {"Kopf": "kopf, paper", "Chen": "chen, paper", "Zhang 2017": "texture, paper"}
BESIDE = {
    "texture": "`texture`, default",
    "texture, best": "`texture`, best (copies)",
    "Gaussian field": "thresholded Gaussian field",
}
PAPER_BONES = (
    ("Bone 1", "0.54", "4.26", "9/3", "6/3"),
    ("Bone 2", "0.61", "3.50", "6/4", "6/4"),
    ("Bone 3", "0.67", "2.01", "7/4", "5/3"),
    ("Bone 4", "0.66", "3.79", "8/5", "4/2"),
    ("Bone 5", "0.55", "4.61", "11/4", "8/6"),
)
"""Table 2: porosity error in per cent, D2, N_cc / N_f, those of the exemplar."""

PAPER_STONES = (
    ("Bentheimer", "1.79", "0.36", "3.51", "0.40"),
    ("Doddington", "3.24", "1.29", "4.86", "3.10"),
    ("Estaillades", "0.83", "1.69", "9.29", "6.89"),
    ("Ketton", "0.27", "1.53", "5.34", "2.95"),
    ("foam Cu", "3.96", "0.36", "4.06", "2.30"),
    ("foam Al", "2.03", "0.40", "4.39", "2.81"),
)
"""Table 3: porosity error in per cent and D2 of the paper, D2 of Zhang 2017 and of the baseline."""

MATERIALS = {"bone": ("by_example_2021", "bone a"), "foam": ("by_example_2017", "sample foam")}
"""Run and exemplar."""
MODELS = ("bone", "berea")
ASKED = "asked for the scan's porosity"
SIDES = ("porosity error %", "D2", "N_cc / N_f", "s")


def sections() -> Iterator[Section]:
    """Give the sections of the page."""
    yield _like_for_like()
    yield _table_1_bone()
    yield _table_1_foam()
    yield _tables_2_and_3()
    yield _losses()
    yield _speed()


def _like_for_like() -> Section:
    """The one method of table 1 that both have at the paper's size: that of 2017."""
    rows = []
    for material, theirs, exemplar in (("bone", BONE, "bone a"), ("foam", FOAM, "sample foam")):
        saved = load("by_example_2021" if material == "bone" else "by_example_2017")
        _, distance, _, seconds = theirs["Zhang 2017"]
        way, best = f"{exemplar}, texture, paper", f"{exemplar}, texture"
        real = spread(saved, "bone a, real elsewhere") if material == "bone" else ""
        rows += [
            Row(
                f"{material}, method of 2017: D2",
                distance,
                spread(saved, way),
                f"default {spread(saved, best)}",
                f"ScaffoldGAN {theirs['all (ScaffoldGAN)'][1]}",
                real,
                seconds,
                f"{saved.cell(way, 's')}; {saved.cell(best, 's')}",
                LESS,
            ),
        ]
    networks, wide = load("gan_shipped"), load("gan_paper")
    done = wide.tables[1].rows[0][0]
    short = f"in {done} iterations of {wide.tables[0].rows[-1][0]} crops"
    error, distance, _, _, seconds = _shipped(networks, "bone")
    asked = _shipped(networks, "bone", asked=True)
    paper = BONE["all (ScaffoldGAN)"]
    rows += [
        Row(
            "bone, network: D2",
            paper[1],
            f"{wide.cell(done, 'D2')} {short}",
            f"`gan`, shipped, {ASKED} {asked[1]}, not asked {distance}",
            f"baseline GAN {BONE['baseline GAN'][1]}",
            then=paper[3],
            now=f"{wide.cell(done, 's')}; {seconds}",
        ),
        Row(
            "bone, network: porosity error, %",
            paper[0],
            f"{wide.cell(done, 'porosity error %')} {short}",
            f"`gan`, shipped, {ASKED} {asked[0]}, not asked {error}",
            f"baseline GAN {BONE['baseline GAN'][0]}",
        ),
    ]
    runs = ["by_example_2021", "by_example_2017", "gan_shipped", "gan_paper"]
    return Section("2021 table 1", runs, rows)


def _table_1(
    saved: Saved, exemplar: str, theirs: dict[str, tuple[str, ...]], own: str
) -> list[list[str]]:
    here = f"{exemplar}, exemplar"
    counts = f"{saved.cell(here, 'N_cc')}/{saved.cell(here, 'N_f')}"
    rows = [["exemplar", "", "", own, "", "", "", counts, saved.cell(here, "largest"), ""]]
    for name, figures in theirs.items():
        row = f"{exemplar}, {OURS.get(name)}"
        of_2017 = load("by_example_2017")
        source = next((one for one in (saved, of_2017) if one.has(row)), None)
        ours = [""] * 5 if source is None else _made(source, row)
        rows.append([name, *figures, *ours])
    return rows + [
        [words, *[""] * 4, *_made(saved, name)]
        for name, words in ((f"{exemplar}, {key}", words) for key, words in BESIDE.items())
        if saved.has(name)
    ]


def _made(saved: Saved, name: str) -> list[str]:
    """Porosity error, D2, components, largest component, seconds of a row."""
    return [
        saved.cell(name, "porosity error %"),
        spread(saved, name),
        f"{saved.cell(name, 'N_cc')}/{saved.cell(name, 'N_f')}",
        saved.cell(name, "largest"),
        saved.cell(name, "s"),
    ]


def _shipped(saved: Saved, name: str, *, asked: bool = False) -> list[str]:
    """The same of a shipped model's ten samples, against the whole scan."""
    table = f"figure of {name}{' asked for' if asked else ''}"

    def value(figure: str, head: str = "mean") -> float:
        return float(saved.cell(figure, head, table=table))

    least, most = (100 * value("two_point_relative", head) for head in ("least", "most"))
    return [
        f"{100 * value('porosity_error'):.2f}",
        f"{100 * value('two_point_relative'):.1f} ({least:.1f} - {most:.1f})",
        f"{value('components'):.0f}",
        f"{value('largest_fraction'):.3f}",
        load("gan_speed").cell(f"{name}, 120^3", "s"),
    ]


def _heads(material: str) -> tuple[str, ...]:
    theirs = (f"paper: {SIDES[0]}", *SIDES[1:])
    return (material, *theirs, f"ours: {SIDES[0]}", *SIDES[1:3], "largest", "s")


def _table_1_bone() -> Section:
    saved = load("by_example_2021")
    rows = _table_1(saved, "bone a", BONE, "6/4")
    for words, asked in (("`gan`, shipped", False), (f"`gan`, shipped, {ASKED}", True)):
        rows.append([words, *[""] * 4, *_shipped(load("gan_shipped"), "bone", asked=asked)])
    elsewhere = _made(saved, "bone a, real elsewhere")
    rows.append(["real, elsewhere", *[""] * 4, *elsewhere])
    return Section(
        "2021 table 1, bone",
        ["by_example_2021", "by_example_2017", "gan_shipped", "gan_speed"],
        heads=_heads("bone"),
        more=rows,
    )


def _table_1_foam() -> Section:
    rows = _table_1(load("by_example_2017"), "sample foam", FOAM, "4/2")
    return Section("2021 table 1, foam", ["by_example_2017"], heads=_heads("foam"), more=rows)


def _tables_2_and_3() -> Section:
    networks, rows = load("gan_shipped"), []
    for name, error, distance, counts, own in PAPER_BONES:
        rows.append([f"paper, {name}", error, distance, counts, own, "", "", ""])
    for name, error, distance, zhang, baseline in PAPER_STONES:
        others = f"Zhang 2017 {zhang}, baseline GAN {baseline}"
        rows.append([f"paper, {name}", error, distance, "", "", "", others, ""])
    for name in ("bone", "foam"):
        rows += [_material(name, way) for way in ("texture, paper", "texture", "texture, best")]
    for name, asked in product(MODELS, (False, True)):
        error, distance, counts, largest, seconds = _shipped(networks, name, asked=asked)
        own = networks.cell("components", "exemplar", table=f"figure of {name}")
        label = f"`gan`, shipped, {name}{', ' + ASKED if asked else ''}"
        rows.append([label, error, distance, counts, own, largest, "", seconds])
    heads = ("", *SIDES[:3], "exemplar's", "largest", "others; real, elsewhere: D2", "s")
    runs = ["by_example_2021", "by_example_2017", "gan_shipped", "gan_speed"]
    return Section("2021 tables 2 and 3", runs, heads=heads, more=rows)


def _material(name: str, way: str) -> list[str]:
    """The rows of table 1 once more, so that tables 2 and 3 have them beside theirs."""
    run, exemplar = MATERIALS[name]
    saved = load(run)
    error, distance, counts, largest, seconds = _made(saved, f"{exemplar}, {way}")
    own, elsewhere = f"{exemplar}, exemplar", f"{exemplar}, real elsewhere"
    real = f"real {spread(saved, elsewhere)}" if saved.has(elsewhere) else ""
    counted = f"{saved.cell(own, 'N_cc')}/{saved.cell(own, 'N_f')}"
    method, _, preset = way.partition(", ")
    label = f"`{method}`{', ' + preset if preset else ''}, {name}"
    return [label, error, distance, counts, counted, largest, real, seconds]


def _losses() -> Section:
    """Tables 2 and 3 with the paper's losses and without, on what trains on a processor."""
    saved, rows = load("gan_losses"), []
    ways = {"": "adversarial only", "+ gram": "+ gram", "+ gram + structural": "all"}
    for material in MATERIALS_OF_LOSSES:
        elsewhere = f"{material}, real elsewhere"
        rows.append(
            [
                material,
                *(saved.cell(f"{material}, {way}", "D2") for way in ways.values()),
                saved.cell(elsewhere, "D2") if saved.has(elsewhere) else "",
                *(saved.cell(f"{material}, {way}", "error %") for way in ways.values()),
                *(_counted(saved, f"{material}, {way}") for way in (*ways.values(), "exemplar")),
            ]
        )
    names = ("adversarial", "+ gram", "+ structural")
    heads = (
        "exemplar",
        *(f"D2: {names[0]}", *names[1:], "real, elsewhere"),
        *(f"porosity error %: {names[0]}", *names[1:]),
        *(f"N_cc / N_f: {names[0]}", *names[1:], "exemplar"),
    )
    return Section("2021 tables 2 and 3, losses", ["gan_losses"], heads=heads, more=rows)


def _counted(saved: Saved, row: str) -> str:
    return f"{saved.cell(row, 'N_cc')}/{saved.cell(row, 'N_f')}"


def _speed() -> Section:
    speed, networks = load("gan_speed"), load("gan_shipped")
    found = "diversity of bone"
    apart, copied = (
        networks.cell("four samples", head, table=found)
        for head in ("least distance", "most copied")
    )
    rows = [
        Row("training", then="14,400 (about 4 hours, GTX 1080)", now="the models' cards"),
        Row("120^3 of bone", then="0.096", now=speed.cell("bone, 120^3", "s")),
        Row("420^3 of bone (figures 9, 10)", then="no figure", now=speed.cell("bone, 420^3", "s")),
        Row("figure 8: least share of voxels in which two samples differ", "to the eye", apart),
        Row("figure 8: most that one sample copies of another, coherence(4)", "", copied),
    ]
    return Section("2021 speed", ["gan_speed", "gan_shipped"], rows)
