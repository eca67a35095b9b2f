"""Copies of a model's sources and of libraries, rewritten as the compiler takes them."""

from __future__ import annotations

import contextlib
import json
import os
import re
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from orchestrator.base.digests import digest_of, file_digest
from orchestrator.base.temporary_folders import cache_folder, keep_last_used

from ..sources import SourceTree, library_texts
from .adapted import ANY, ANY_MODEL, adapted
from .buses import types_of_members, with_members
from .component_arrays import with_component_arrays
from .external_objects import Objects, external_objects
from .hidden_sections import Section, Sections
from .iterators import with_plain_iterators
from .specialised import specialised, specialised_library

# Modules that rewrite libraries: a copy is of their version.
_REWRITERS = (Path(__file__).parents[1] / "built_in.py", *sorted(Path(__file__).parent.glob("*.py")))
_MOST_COPIES = 4  # of libraries, each of some 26 MB
_SECTIONS = "sections.json"  # of the copy of a library


def needed_rewrites(refusal: str) -> frozenset[str]:
    """What `prepared` has to rewrite for a model that the compiler refuses."""
    needed = set()
    if re.search(r"owner `function (statement|return|loop)|missing function value", refusal):
        needed.add("functions")
    if loop := re.search(r"owner `function loop domain`: `([\w.]+)`", refusal):
        needed |= {"functions", f"function {loop[1]}"}  # limits of an inner loop depend on the outer one
    if re.search(r"unsupported (model|initial) algorithm|(for|while|if|when)-statement", refusal):
        needed.add("sections")
    if re.search(
        r"is not a discrete coordinate|reinit\(\) can only be applied to state variables: \S*\[", refusal
    ):
        needed |= {"sections", "whens"}  # a when-equation that sets elements of an array
    return frozenset((*needed, *types_of_members(refusal)))


def prepared(
    tree: SourceTree,
    folder: Path,
    libraries: Sequence[Path],
    rewritten: frozenset[str] = frozenset(),
    sections: Sections | None = None,
) -> tuple[list[Path], frozenset[str]]:
    """Rewrite the copy of a model's sources as the compiler takes them.

    Args:
        rewritten: "functions" where those with while, break or return become external, "function NAME"
            where this one does, whatever it holds, "sections" where the compiler is to see no algorithm
            section, "whens" where when-equations count as such; what `types_of_members` found.
        sections: gets those that it does not see.
    Returns: the folders of libraries as it takes them; files of the model that differ from before.
    """
    roots, objects = [], {}
    functions: frozenset[str] | None = None
    if "functions" in rewritten:
        functions = frozenset(re.findall(r"^function (.+)$", "\n".join(sorted(rewritten)), re.MULTILINE))
    if sections is None or "sections" not in rewritten:
        sections = None
    for library in libraries:
        root, found = _adapted_library(library, functions, sections)
        roots.append(root)
        objects |= found
    before = {path: path.read_bytes() for path in folder.rglob("*.mo")}
    if libraries:
        modernised(folder)
    texts = {path: path.read_bytes().decode() for path in before}
    named = {path.relative_to(folder).as_posix(): text for path, text in texts.items()}
    named |= with_members(named, rewritten)
    for rewrite in (with_plain_iterators, with_component_arrays, with_plain_iterators):
        named |= rewrite(named)
    texts = {folder / path: text for path, text in named.items()}
    objects |= external_objects(texts.values())
    common, models = _of_all(tree)
    for path, text in texts.items():
        whens = "whens" in rewritten
        new = adapted(text, path.name, objects, common, models, functions, sections, whens).encode()
        if new != before[path]:
            path.write_bytes(new)
    if common:
        (folder / f"{ANY}.mo").write_text(ANY_MODEL)
    changed = [path for path, content in before.items() if path.read_bytes() != content]
    return roots, frozenset(path.relative_to(folder).as_posix() for path in changed)


def adapts(tree: SourceTree) -> bool:
    """Whether the compiler does not see a model's sources as they are."""
    if any(one(tree.texts) for one in (with_members, with_plain_iterators, with_component_arrays)):
        return True
    if specialised(tree).texts != tree.texts:
        return True
    objects = external_objects(tree.texts.values())
    common, models = _of_all(tree)
    return any(adapted(text, file, objects, common, models) != text for file, text in tree.texts.items())


def _of_all(tree: SourceTree) -> tuple[bool, frozenset[str]]:
    """Whether anything is redeclared, and the names of all models."""
    common = any("redeclare" in text for text in tree.texts.values())
    return common, frozenset(one.name for one in tree.classes.values() if one.kind in ("model", "block"))


def _adapted_library(
    library: Path, functions: frozenset[str] | None, sections: Sections | None
) -> tuple[Path, Objects]:
    """A library's folder as the compiler takes it, and its external objects; adds to `sections`.

    The compiler reads a folder that it knows several times as fast, so that copies are kept.
    """
    paths = sorted(library.rglob("*.mo"))
    stats = [(str(one.relative_to(library)), one.stat()) for one in paths]
    state = [(name, stat.st_size, stat.st_mtime_ns) for name, stat in stats]
    kept = cache_folder("libraries") / digest_of(
        json.dumps(
            [
                [file_digest(one) for one in _REWRITERS],
                str(library.resolve()),
                functions if functions is None else sorted(functions),
                sections is not None,
                state,
            ]
        ).encode()
    )
    kept.parent.mkdir(parents=True, exist_ok=True)
    texts, _ = library_texts(library)
    objects = external_objects(texts.values())
    if not kept.is_dir():
        found: Sections | None = None if sections is None else {}
        texts = specialised_library(texts, f"{library.as_posix()}/", library)
        with tempfile.TemporaryDirectory(dir=kept.parent) as scratch:
            for path, text in texts.items():
                target = Path(scratch) / "root" / path
                target.parent.mkdir(parents=True, exist_ok=True)
                new = adapted(text, str(library / path), objects, functions=functions, sections=found)
                target.write_bytes(new.encode())
            kept_sections = {key: asdict(one) for key, one in (found or {}).items()}
            (Path(scratch) / "root" / _SECTIONS).write_text(json.dumps(kept_sections))
            with contextlib.suppress(OSError):  # another process was first
                (Path(scratch) / "root").rename(kept)
    with contextlib.suppress(OSError):
        os.utime(kept)
    keep_last_used(kept.parent, _MOST_COPIES)
    if sections is not None:
        kept_sections = json.loads((kept / _SECTIONS).read_text())
        sections.update({key: Section(**one) for key, one in kept_sections.items()})
    return kept, objects


def modernised(folder: Path) -> None:
    """Name the units and frequencies of version 3 of the Modelica Standard Library as version 4 does.

    As its own conversion script ConvertModelica_from_3.2.3_to_4.0.0 does.
    """
    for path in folder.rglob("*.mo"):
        text = path.read_text()
        if re.search(r"\bfreqHz\s*=", text) and not re.search(r"\w\s+freqHz\b", text):
            text = re.sub(r"\bfreqHz(\s*=)", r"f\1", text)
            path.write_text(text)
        if "Modelica.SIunits" in text:
            text = re.sub(r"\bimport\s+Modelica\.SIunits\s*;", "import SIunits = Modelica.Units.SI;", text)
            text = text.replace("Modelica.SIunits.Conversions", "Modelica.Units.Conversions")
            path.write_text(text.replace("Modelica.SIunits", "Modelica.Units.SI"))
