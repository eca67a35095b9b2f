"""Folders of Modelica files without a package.mo, and names of platforms."""

from __future__ import annotations

from time import process_time

import pytest

from orchestrator.base.errors import BuildError
from orchestrator.translate.build import build
from orchestrator.translate.package import PLATFORMS, named_platforms
from orchestrator.translate.sizes import refuse_large_sizes
from orchestrator.translate.sources import load_sources

TANK = """within Plant.Parts;
model Tank
  parameter Real rate(unit = "1/s") = 2;
  output Real level(start = 1, fixed = true);
equation
  der(level) = -rate * level;
end Tank;
"""
MAIN = """within Plant;
model Main
  Parts.Tank tank(rate = 3);
  output Real level = tank.level;
end Main;
"""


def plant(tmp_path, top: bool):
    """A package Plant whose sub-folder Parts has no package.mo; `top`: whether Plant has one."""
    folder = tmp_path / "Plant"
    (folder / "Parts").mkdir(parents=True)
    (folder / "Parts" / "Tank.mo").write_text(TANK)
    (folder / "Main.mo").write_text(MAIN)
    if top:
        (folder / "package.mo").write_text("package Plant\nend Plant;\n")
    return folder


@pytest.mark.parametrize("top", [True, False])
@pytest.mark.parametrize("file", ["Main.mo", "Parts/Tank.mo"])
def test_a_folder_without_a_package_file_is_read_as_a_package_with_a_remark(file, top, tmp_path):
    folder = plant(tmp_path, top)
    made = build(folder / file, tmp_path / "X.fmu", platforms=())
    reported = [note for note in made.notes if "has no package.mo and is read as a package" in note]
    assert len(reported) == (1 if top else 2)
    assert any(note.startswith(f"{folder}/Parts/ has") for note in reported)
    assert not (folder / "Parts" / "package.mo").exists()
    assert made.counts["states"] == 1


def test_a_file_without_a_within_clause_belongs_to_its_folder_by_its_class(tmp_path):
    folder = plant(tmp_path, True)
    (folder / "Parts" / "Tank.mo").write_text(TANK.partition("\n")[2])
    made = build(folder / "Main.mo", tmp_path / "X.fmu", platforms=())
    assert f"{folder}/Parts/ has no package.mo and is read as a package" in made.notes
    assert made.counts["states"] == 1


def test_files_that_do_not_belong_to_a_folder_without_a_package_file_are_left_out(tmp_path):
    folder = plant(tmp_path, True)
    extra = folder / "Resources"
    extra.mkdir()
    (extra / "de.mo").write_bytes(b"\xde\x12\x04\x95\x00\x00")  # a translation of gettext
    (extra / "Elsewhere.mo").write_text("within Other;\nmodel Elsewhere\nend Elsewhere;\n")
    (extra / "script.mo").write_text('loadFile("x");\n')
    made = build(folder / "Main.mo", tmp_path / "X.fmu", platforms=())
    left = [note.partition(" is left out")[0] for note in made.notes if "is left out" in note]
    assert left == [f"{extra}/{name}" for name in ("Elsewhere.mo", "de.mo", "script.mo")]
    assert not any("Resources/ has no package.mo" in note for note in made.notes)


@pytest.mark.parametrize("given", ["Plant", "."])
def test_a_library_with_a_folder_without_a_package_file_loads_with_a_remark(given, tmp_path):
    folder = plant(tmp_path, True)
    (folder / "Parts" / "de.mo").write_bytes(b"\xde\x12\x04\x95\x00\x00")  # a translation of gettext
    model = tmp_path / "Use.mo"
    model.write_text("model Use\n  extends Plant.Main;\nend Use;\n")
    made = build(model, tmp_path / "X.fmu", platforms=(), libraries=[tmp_path / given])
    read = "has no package.mo and is read as a package"
    out = "its folder has no package.mo and it is no class of it"
    assert {f"{folder}/Parts/ {read}", f"{folder}/Parts/de.mo is left out: {out}"} <= {*made.notes}
    assert made.counts["states"] == 1 and not (folder / "Parts" / "package.mo").exists()


def test_files_that_say_nothing_of_a_package_stay_alone(tmp_path):
    (tmp_path / "M.mo").write_text("model M\n  output Real x = time;\nend M;\n")
    tree = load_sources(tmp_path / "M.mo")
    assert tree.remarks == () and list(tree.texts) == ["M.mo"]


@pytest.mark.parametrize(
    ("names", "keys"),
    [
        (["linux64", "win64", "darwin64"], list(PLATFORMS)),
        (["x86_64-linux", "linux64"], ["x86_64-linux"]),
        (["darwin64"], ["x86_64-darwin", "aarch64-darwin"]),
        ([], []),
    ],
)
def test_platforms_go_by_the_names_of_both_versions_of_fmi(names, keys):
    assert list(named_platforms(names)) == keys


def test_unknown_platforms_are_refused_with_all_names():
    with pytest.raises(BuildError) as caught:
        named_platforms(["linux64", "solaris", "vms"])
    assert str(caught.value) == (
        "unknown platform solaris, vms; known: x86_64-linux, x86_64-windows, x86_64-darwin, aarch64-darwin, "
        "or by the folders of FMI 2.0 linux64, win64, darwin64"
    )


@pytest.mark.parametrize("line", ["for i in -1e300:n loop", "for i in 1:4294967296 loop"])
def test_ranges_that_no_memory_holds_are_refused_before_they_are_tried(line, tmp_path):
    head = "model M\n  parameter Integer n = 2;\n  Real x[2];\nequation\n"
    text = f"{head}  {line}\n    x[i] = i;\n  end for;\nend M;\n"
    (tmp_path / "M.mo").write_text(text)
    with pytest.raises(
        BuildError, match=r"M\.mo:5: a range up to .* is too large; at most 1,000,000 is taken"
    ):
        build(tmp_path / "M.mo", tmp_path / "M.fmu", platforms=())


@pytest.mark.parametrize(
    ("declared", "size"),
    [
        ("parameter Integer n = 2000000000;\n  Real x[n];", "2,000,000,000"),
        ("parameter Integer k = 50000, n(min = 1) = k * k;\n  Real x[n];", "2,500,000,000"),
        ("constant Integer n = 2 ^ 40;\n  Real[n] x;", "1,099,511,627,776"),
        ("parameter Integer n = 30000;\n  Real x[n, n + 1];", "900,030,000"),
        ("parameter Integer n = 4000;\n  Real x[:, :] = identity(n);", "16,000,000"),
        ("parameter Integer n = 4000;\n  Real x[:, :] = fill(1e9, n, n);", "16,000,000"),
        ("S s(n = 100000000);\n", "100,000,000"),
    ],
)
def test_sizes_by_parameters_that_no_memory_holds_are_refused_at_once(declared, size, tmp_path):
    sub = "model S\n  parameter Integer n(min = 1) = 2;\n  Real[n] x;\nequation\n  x = ones(n);\nend S;\n"
    (tmp_path / "M.mo").write_text(f"{sub}model M\n  {declared}\nequation\n  x = 2 * x;\nend M;\n")
    begin = process_time()
    with pytest.raises(BuildError, match=rf"M\.mo:\d+: (a size of|an array .*) {size} is too large; "):
        build(tmp_path / "M.mo", tmp_path / "M.fmu", model="M", platforms=())
    assert process_time() - begin < 10.0


@pytest.mark.parametrize(
    "declared",
    [
        "parameter Real table[:, 2] = [2e6, 1; 5e9, 2];\n  Real y = table[2, 1];",
        "parameter Integer s = 2000000000, n = k + 1, k = 2;\n  Real x[n] = ones(3);\n  Real y = x[1] + s;",
        "Real x[3] = fill(1e9, 3);\n  Real y = x[2];",
    ],
)
def test_large_numbers_that_are_no_sizes_are_taken(declared, tmp_path):
    state = "output Real z(start = 0, fixed = true);\nequation\n  der(z) = y - z;"
    (tmp_path / "M.mo").write_text(f"model M\n  {declared}\n  {state}\nend M;\n")
    build(tmp_path / "M.mo", tmp_path / "M.fmu", platforms=())
    assert (tmp_path / "M.fmu").is_file()


def test_sizes_are_judged_in_the_files_that_a_model_may_use(tmp_path):
    """Not in a whole library around it, which takes seconds to read."""
    folder = tmp_path / "Pack"
    folder.mkdir()
    (folder / "package.mo").write_text("package Pack\nend Pack;\n")
    (folder / "Used.mo").write_text("within Pack;\nmodel Used\n  Real x = time;\nend Used;\n")
    (folder / "Huge.mo").write_text("within Pack;\nmodel Huge\n  Real x[200000];\nend Huge;\n")
    tree = load_sources(folder / "Used.mo")
    refuse_large_sizes(tree, "Pack.Used")
    with pytest.raises(BuildError, match=r"Huge\.mo:3: a size of 200,000 is too large"):
        refuse_large_sizes(tree, "Pack.Huge")


def test_classes_in_files_beside_the_model_are_found(tmp_path):
    """Tank uses Valve, which uses a constant of Data; Wrong.mo is no Modelica and not named."""
    (tmp_path / "Tank.mo").write_text(
        "model Tank\n  Valve valve;\n  Real h(start=1, fixed=true);\n"
        "equation\n  der(h) = -valve.k*h;\nend Tank;\n"
    )
    (tmp_path / "Valve.mo").write_text("model Valve\n  parameter Real k = Data.k;\nend Valve;\n")
    (tmp_path / "Data.mo").write_text("package Data\n  constant Real k = 2;\nend Data;\n")
    (tmp_path / "h.mo").write_text("no Modelica (")
    made = build(tmp_path / "Tank.mo", tmp_path / "X.fmu", platforms=())
    assert made.counts["states"] == 1
    beside = [note for note in made.notes if "stands beside the model, and is read with it" in note]
    assert [note.partition(" ")[0].rpartition("/")[2] for note in beside] == ["Data.mo", "Valve.mo"]


def test_of_several_models_the_one_that_uses_the_others_is_built(tmp_path):
    file = tmp_path / "All.mo"
    file.write_text(
        "connector Pin\n  Real v;\n  flow Real i;\nend Pin;\n"
        "partial model Base\n  Real x(start=1, fixed=true);\nend Base;\n"
        "model Part\n  parameter Real k = 2;\nend Part;\n"
        "model Whole\n  extends Base;\n  Part part;\nequation\n  der(x) = -part.k*x;\nend Whole;\n"
    )
    assert load_sources(file).model_name(None) == "Whole"
    assert build(file, tmp_path / "X.fmu", platforms=()).counts["states"] == 1


def test_a_single_backslash_in_a_text_stands_for_itself(tmp_path):
    file = tmp_path / "M.mo"
    file.write_bytes(rb"""model M
  parameter String path = "C:\Work\table.txt", tab = "a\tb\\";
  Real y = time;
end M;
""")
    assert r'"C:\\Work\table.txt", tab = "a\tb\\"' in load_sources(file).texts["M.mo"]
    assert build(file, tmp_path / "X.fmu", platforms=()).counts["states"] == 0
