"""What the package says of its versions, extras, workflows and releases."""

import importlib.util
import json
import re
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def parts(requirement):
    """Name, operator, release without zeros at its end, and marker of a requirement."""
    text, _, marker = requirement.partition(";")
    name, operator, release = re.fullmatch(r"([\w.-]+?)(>=|==)([\d.]+)", text.strip()).groups()
    return name, operator, re.sub(r"(\.0)+$", "", release), re.sub(r"[\s'\"]", "", marker)


def test_the_oldest_versions_that_are_tried_are_the_lower_bounds():
    lines = (ROOT / "requirements" / "oldest.txt").read_text(encoding="utf-8").splitlines()
    tried = [parts(line) for line in lines if not line.startswith("#")]
    bounds = [parts(requirement) for requirement in PROJECT["dependencies"]]
    assert {one[1] for one in tried} == {"=="} and {one[1] for one in bounds} == {">="}
    assert [(name, release, marker) for name, _, release, marker in tried] == [
        (name, release, marker) for name, _, release, marker in bounds
    ]


def test_the_pythons_that_are_named_begin_with_the_oldest_that_is_allowed():
    named = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["classifiers"]))
    assert PROJECT["requires-python"] == f">={named[0]}" and named == sorted(
        named, key=lambda one: int(one[2:])
    )


EXTRAS = PROJECT["optional-dependencies"]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))


def bare(requirements):
    """Names of packages, without extras, bounds and markers."""
    return {re.match(r"[\w.-]+", one)[0].lower() for one in requirements}


def within(text):
    """Extras of this package that one of its own extras names."""
    return re.fullmatch(r"trabecula\[([\w,]+)\]", text)[1].split(",")


@pytest.fixture(scope="module")
def release():
    """release/check.py as a module."""
    place = ROOT / "release" / "check.py"
    module = importlib.util.module_from_spec(
        spec := importlib.util.spec_from_file_location("release_check", place)
    )
    spec.loader.exec_module(module)
    return module


def test_the_extras_all_and_dev_name_the_others():
    together = within(EXTRAS["all"][0]) + within(EXTRAS["dev"][0])
    assert len(EXTRAS["all"]) == len(EXTRAS["dev"]) == 1
    # napari is an application with Qt: its plugin is asked for by name
    assert sorted([*together, "napari", "all", "dev"]) == sorted(EXTRAS)


def test_nothing_that_users_install_is_pinned_to_one_version():
    for name, lines in {"": PROJECT["dependencies"], **EXTRAS}.items():
        for line in lines:
            assert "==" not in line.partition(";")[0], (name, line)


@pytest.mark.parametrize("file", ["learn", "cluster", "remote", "docs", "napari"])
def test_the_pins_of_an_extra_lie_in_its_range(file):
    lines = (ROOT / "requirements" / f"{file}.txt").read_text(encoding="utf-8").splitlines()
    pins = dict(line.split("==") for line in lines if re.match(r"[\w.-]+==", line))
    pins = {name.lower(): version for name, version in pins.items()}
    for requirement in EXTRAS[file]:
        name = re.match(r"[\w.-]+", requirement)[0].lower()
        numbers = [int(part) for part in pins[name].split(".")]
        lowest = re.search(r">=([\d.]+)", requirement)[1]
        above = re.search(r"<([\d.]+)", requirement)
        assert numbers >= [int(part) for part in lowest.split(".")]
        assert above is None or numbers < [int(part) for part in above[1].split(".")]


def test_workflows_try_the_pythons_that_are_named_on_every_system():
    named = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["classifiers"]))
    jobs = yaml.safe_load((ROOT / ".github/workflows/test.yml").read_text(encoding="utf-8"))["jobs"]
    matrix = jobs["test"]["strategy"]["matrix"]
    assert matrix["python"] == named
    assert [one.partition("-")[0] for one in matrix["os"]] == ["ubuntu", "macos", "windows"]


def test_workflows_name_targets_and_files_that_exist():
    assert [one.stem for one in WORKFLOWS] == ["docs", "figures", "release", "test"]
    targets = set(re.findall(r"(?m)^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8")))
    for place in WORKFLOWS:
        jobs = yaml.safe_load(place.read_text(encoding="utf-8"))["jobs"]
        for job in jobs.values():
            assert set(job.get("needs", "").split()) <= set(jobs)
            assert job["runs-on"] and "contents" not in job.get("permissions", {})
            commands = "\n".join(step.get("run", "") for step in job["steps"])
            for target in re.findall(r"(?m)^make ([a-z-]+)", commands):
                assert target in targets, f"{place.name}: make {target}"
            for file in re.findall(r"[\w/]+\.(?:py|txt)", commands):
                assert (ROOT / file).is_file(), f"{place.name}: {file}"
            for extra in re.findall(r'"\.\[(\w+)\]"', commands):
                assert extra in EXTRAS


def test_only_the_release_may_publish_a_package_and_only_by_its_tag():
    text = {one.stem: yaml.safe_load(one.read_text(encoding="utf-8")) for one in WORKFLOWS}
    publishing = [
        (name, job)
        for name, one in text.items()
        for job, what in one["jobs"].items()
        if "id-token" in what.get("permissions", {})
    ]
    assert publishing == [("docs", "publish"), ("release", "publish")]
    # YAML 1.1 reads the key `on` as true
    assert text["release"][True] == {"push": {"tags": ["v*"]}}
    assert text["release"]["jobs"]["publish"]["needs"] == "try"


def test_the_recipe_of_conda_asks_for_what_the_wheel_asks():
    text = (ROOT / "release" / "conda" / "recipe.yaml").read_text(encoding="utf-8")
    recipe = yaml.safe_load(text)
    run = dict(line.split(" ", 1) for line in recipe["requirements"]["run"])
    assert run.pop("python") == ">=${{ python_min }}"
    assert PROJECT["requires-python"] == f">={recipe['context']['python_min']}"
    # one package for every Python: of two bounds it has the higher
    bounds = {}
    for requirement in PROJECT["dependencies"]:
        name, _, rest = requirement.partition(";")[0].partition(">=")
        bounds[name] = max(bounds.get(name, ""), ">=" + rest)
    assert run == bounds
    assert recipe["about"]["summary"] == PROJECT["description"]
    (entry,) = recipe["build"]["python"]["entry_points"]
    name, _, target = entry.partition(" = ")
    assert PROJECT["scripts"] == {name: target}


@pytest.mark.parametrize("name", ["Dockerfile", "apptainer.def"])
def test_containers_copy_files_that_exist(name):
    text = (ROOT / "release" / name).read_text(encoding="utf-8")
    named = re.findall(r"(?m)^(?:COPY|   )\s+((?:[\w./]+ )+)/?[\w./]+$", text)
    files = [file for line in named for file in line.split()]
    assert {"pyproject.toml", "src", "requirements/base.txt"} <= set(files)
    for file in files:
        assert (ROOT / file).exists(), file
        ignored = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
        assert f"!{file}" in ignored


def test_a_tag_is_the_version_with_its_date_in_log_and_citation(release, tmp_path):
    (tmp_path / "src" / "trabecula").mkdir(parents=True)
    (tmp_path / "src/trabecula/__init__.py").write_text('"""Doc."""\n\n__version__ = "1.2.3"\n')
    (tmp_path / "pyproject.toml").write_text('[project]\nurls = {Source = "https://a.test/b"}\n')
    (tmp_path / "CHANGELOG.md").write_text("# Changelog\n\n## 1.2.3, 2027-01-31\n")
    good = 'title: x\nversion: 1.2.3\ndate-released: "2027-01-31"\n'
    (tmp_path / "CITATION.cff").write_text(good)
    assert list(release.check_tag("v1.2.3", tmp_path)) == []
    assert [*release.check_tag("1.2.3", tmp_path)] and [*release.check_tag("v1.2.4", tmp_path)]
    (tmp_path / "CITATION.cff").write_text(good.replace("01-31", "02-01"))
    assert "2027-01-31" in " ".join(release.check_tag("v1.2.3", tmp_path))
    (tmp_path / "CHANGELOG.md").write_text("## 1.2.3, unreleased\n")
    assert "YYYY-MM-DD" in " ".join(release.check_tag("v1.2.3", tmp_path))


def test_a_placeholder_for_the_project_is_not_published(release):
    faults = " ".join(release.check_tag(f"v{release.version()}"))
    assert ("example.org" in faults) == ("example.org" in json.dumps(PROJECT["urls"]))


def test_the_version_has_one_home(release):
    import trabecula

    assert release.version() == trabecula.__version__ and "version" in PROJECT["dynamic"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == trabecula.__version__


def test_a_wheel_is_small_and_whole(release, tmp_path, monkeypatch):
    path = tmp_path / "trabecula-1.0-py3-none-any.whl"
    names = ["py.typed", "__init__.pyi", "napari/napari.yaml"]
    with zipfile.ZipFile(path, "w") as file:
        for name in names:
            file.writestr(f"trabecula/{name}", "")
        file.writestr("trabecula-1.0.dist-info/METADATA", "")
    assert list(release.check_wheel(path)) == []
    with zipfile.ZipFile(path, "a") as file:
        file.writestr("tests/x.py", "")
    assert "tests" in " ".join(release.check_wheel(path))
    monkeypatch.setattr(release, "LARGEST_WHEEL", 100)
    assert "more than 100" in " ".join(release.check_wheel(path))


def test_the_recipe_of_a_release_has_its_version_and_hash(release, tmp_path):
    sdist = tmp_path / "trabecula-9.8.7.tar.gz"
    sdist.write_bytes(b"abc")
    recipe = yaml.safe_load(release.write_recipe(sdist, tmp_path / "recipe.yaml").read_text())
    assert recipe["context"]["version"] == "9.8.7"
    assert recipe["source"]["sha256"].startswith("ba7816bf8f01cfea414140de5dae2223b00361a3")
