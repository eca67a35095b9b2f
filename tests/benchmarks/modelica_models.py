"""How many models of a Modelica package become FMUs, simulate, and agree with the compiler's own simulator.

    python -m tests.benchmarks.modelica_models PACKAGE.mo [--library DIR] [--models FILE] [--match TEXT]
    python -m tests.benchmarks.modelica_models LIBRARY_FOLDER --models FILE [--references DIR]

Without --models all models of the package that are not partial are tried; of a library's folder those
that the file names. Each is built for this machine, run over its experiment (1 s without one) by fmpy, and
compared at 103 points, which no sample of a round period meets: with a solution of `book_solutions` or
`library_solutions`, else with the CSV file of the library's reference results, where DIR has one, else with
rumoca's simulator.
The package and the library stay where they are; nothing of them is written.
"""

from __future__ import annotations

import argparse
import json
import re
import select
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from .book_solutions import SOLUTIONS
from .library_solutions import LIBRARY_SOLUTIONS

LIMIT = 150.0
POINTS = 103.7
WITHIN = 1e-3


def wrapped(library: Path, names: list[str], folder: Path) -> Path:
    """A package with one model for each of a library's, which extends it."""
    lines = ["package Tried"]
    for name in names:
        parts, stop = name.split("."), "1"
        for depth in range(len(parts), 0, -1):
            place = library.joinpath(*parts[:depth])
            file = next(
                (one for one in (place.with_suffix(".mo"), place / "package.mo") if one.is_file()), None
            )
            if file is None:
                continue
            text = file.read_text()
            begin = re.search(rf"\bmodel\s+{parts[-1]}\b", text)
            body = text[begin.start() :] if begin else text
            body = body[: body.find(f"end {parts[-1]};")]
            found = re.search(r"experiment\s*\([^)]*StopTime\s*=\s*([^,)\s]+)", body)
            stop = found[1] if found else "1"
            break
        lines.append(
            f"model {name.replace('.', '_')} extends {name}; annotation(experiment(StopTime={stop})); "
            f"end {name.replace('.', '_')};"
        )
    package = folder / "Tried.mo"
    package.write_text("\n".join([*lines, "end Tried;", ""]))
    return package


def referenced(found: Any, csv: Path) -> dict[str, Any]:
    """As `compared`, with a CSV file."""
    with csv.open() as file:
        names = [one.strip().strip('"') for one in re.findall(r'"[^"]*"|[^,]+', file.readline())]
        table = np.loadtxt(file, delimiter=",", ndmin=2)
    return compared(found, names, table) | {"by": "reference"}


def tried(path: Path, libraries: list[Path], references: Path | None) -> None:
    """Read names from standard input, and print what became of each as JSON."""
    import fmpy
    import rumoca

    from orchestrator.base.errors import BuildError
    from orchestrator.translate.audit import experiment
    from orchestrator.translate.build import compiled, model_identifier
    from orchestrator.translate.hybrid import build as hybrid
    from orchestrator.translate.hybrid.front_end import dae_form
    from orchestrator.translate.package import this_platform, write_fmu
    from orchestrator.translate.rewriting.copies import needed_rewrites, prepared
    from orchestrator.translate.rewriting.specialised import specialised
    from orchestrator.translate.sources import load_sources

    tree = specialised(load_sources(path), "", libraries)
    with ExitStack() as stack:
        scratch = stack.enter_context(tempfile.TemporaryDirectory())

        @cache
        def session(rewritten: frozenset[str]) -> tuple[Any, Path]:
            folder = stack.enter_context(tree.marked_copy(renamed=False))
            roots, _ = prepared(tree, folder, libraries, rewritten)
            return rumoca.Session(roots=[str(folder), *map(str, roots)]), folder

        def loaded(name: str, rewritten: frozenset[str] = frozenset()) -> Any:
            compiler, folder = session(rewritten)
            try:
                model = compiler.load(str(folder / tree.main), model=name)
                return model, json.loads(model.to_json("dae"))
            except rumoca.RumocaError as error:
                more = rewritten | needed_rewrites(str(error))
                if "sections" in more:  # without its algorithms it is no model that rumoca simulates
                    return None, dae_form(tree, name, libraries)
                if more == rewritten:
                    raise
            return loaded(name, more)

        for line in sys.stdin:
            name, stage = line.strip(), "compiler"
            answer: dict[str, Any] = {}
            messages: list[str] = []
            try:
                model, document = loaded(name)
                stage = "translation"
                # Read once, by the session that holds the library.
                hybrid.dae_form = lambda *_, read=document: read
                identifier = model_identifier(name)
                members, counts, _ = hybrid.translate_hybrid(tree, name, identifier, "2.0", libraries)
                stage = "binary"
                members |= compiled(members, identifier, "2.0", (this_platform(),))
                fmu = Path(scratch) / "model.fmu"
                write_fmu(fmu, members)
                stage = "simulation"
                stop = experiment(tree.classes[name]).get("StopTime", 1.0)
                found = fmpy.simulate_fmu(
                    str(fmu), stop_time=stop, output_interval=stop / POINTS, step_size=stop / POINTS,
                    output=[one.name for one in fmpy.read_model_description(str(fmu)).modelVariables][1:],
                    logger=lambda *said, into=messages: into.append(said[-1].decode()),
                )  # fmt: skip
                stage = "comparison"
                own = (SOLUTIONS | LIBRARY_SOLUTIONS).get(name.partition(".")[2])
                if own is not None:
                    solved = own(found["time"])
                    table = np.column_stack([found["time"], *solved.values()])
                    answer = compared(found, ["time", *solved], table) | {"by": "scipy"}
                    print(
                        "@" + json.dumps({"stage": stage, **answer, "states": counts["states"]}), flush=True
                    )
                    continue
                csvs = (
                    {
                        str(one.parent.relative_to(references)).replace("/", ".").replace(".", "_"): one
                        for one in references.rglob("*.csv")
                    }
                    if references
                    else {}
                )
                csv = csvs.get(name.removeprefix("Tried."))
                if csv is not None and csv.stat().st_size:  # some copies lack what large files hold
                    answer = referenced(found, csv) | {"states": counts["states"]}
                    print("@" + json.dumps({"stage": stage, **answer}), flush=True)
                    continue
                if model is None:
                    answer = {"what": "rumoca does not simulate it", "states": counts["states"]}
                    print("@" + json.dumps({"stage": stage, **answer}), flush=True)
                    continue
                config = rumoca.SimConfig(rtol=1e-8, atol=1e-9, dt=stop / POINTS, max_wall_seconds=20.0)
                other = model.simulate(stop, config=config)
                columns = [other.time, *(other.to_numpy([one])[0] for one in other.names)]
                table = np.column_stack([np.asarray(one, dtype=float) for one in columns])
                answer = compared(found, ["time", *other.names], table) | {"states": counts["states"]}
            except BuildError as error:
                answer = {"what": str(error)}
            except Exception as error:
                said = "; ".join([f"{type(error).__name__} {error}", *messages[-1:]])
                answer = {"what": said}
            print("@" + json.dumps({"stage": stage, **answer}), flush=True)


def compared(ours: Any, names: list[str], table: np.ndarray) -> dict[str, Any]:
    """The largest difference of a signal, in shares of its range, which is at least 1e-4 of its size.

    Args:
        names: of the columns of the table, of which the first is the time.
    """
    worst, where = 0.0, ""
    times = table[:, 0]
    aside = 1e-9 * times[-1]
    count = 0
    for name in ours.dtype.names[1:]:
        if name not in names:
            continue
        other = table[:, names.index(name)]
        own = ours[name].astype(float)
        # Where a signal jumps, the two may sample either side of the jump.
        sides = [np.interp(ours["time"] + shift, times, other) for shift in (-aside, 0.0, aside)]
        at = np.clip(own, np.min(sides, axis=0), np.max(sides, axis=0))
        steady = np.ones(len(own), dtype=bool)
        span = max(np.ptp(other), np.ptp(own), 1e-4 * np.abs(other).max(), 1e-9)
        jumps = np.abs(np.diff(own)) > 0.2 * span
        steady[1:] &= ~jumps
        steady[:-1] &= ~jumps
        if not steady.any():
            continue
        count += 1
        gap = float(np.abs(own - at)[steady].max() / span)
        if gap > worst:
            worst, where = gap, name
    return {"gap": worst, "where": where, "signals": count}


def main() -> int:
    """Try the models and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("package", type=Path)
    parser.add_argument("--library", type=Path, action="append", default=[])
    parser.add_argument("--models", type=Path, help="a file with one name a line")
    parser.add_argument("--match", default="", help="only models whose names match")
    parser.add_argument("--references", type=Path, help="folder of reference results of the library")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.worker:
        tried(args.package, args.library, args.references)
        return 0
    from orchestrator.translate.sources import load_sources

    rest = sys.argv[2:]
    if args.package.is_dir():
        assert args.models is not None
        library, folder = args.package, Path(tempfile.mkdtemp())
        args.package = wrapped(library, args.models.read_text().split(), folder)
        rest = [
            "--library",
            str(library),
            *(["--references", str(args.references)] if args.references else []),
        ]
        args.models = None
    tree = load_sources(args.package)
    if args.models:
        names = args.models.read_text().split()
    else:
        names = [
            one.name
            for one in tree.classes.values()
            if one.kind in ("model", "block")
            and not re.search(
                rf"\bpartial\s+{one.kind}\s+{re.escape(one.name.rpartition('.')[2])}\b", tree.texts[one.file]
            )
        ]
    names = [one for one in names if re.search(args.match, one)]
    command = [sys.executable, "-m", "tests.benchmarks.modelica_models", str(args.package), *rest, "--worker"]

    def started() -> subprocess.Popen[str]:
        return subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            bufsize=1,
        )

    worker, counts = started(), Counter[str]()
    print("| model | states | outcome |\n|---|---|---|")
    for name in names:
        if worker.poll() is not None:
            worker = started()
        assert worker.stdin is not None and worker.stdout is not None
        worker.stdin.write(name + "\n")
        answer, end = None, time.monotonic() + LIMIT
        while answer is None and select.select([worker.stdout], [], [], max(0.0, end - time.monotonic()))[0]:
            line = worker.stdout.readline()
            if not line:
                break
            answer = json.loads(line[1:]) if line.startswith("@") else None
        if answer is None:
            worker.kill()
            worker.wait()
            answer = {"stage": "compiler", "what": f"crashed, or took more than {LIMIT:g} s"}
        if answer.get("signals") == 0:
            answer = {"stage": "comparison", "what": "no signal can be compared"}
        if "gap" in answer:
            agrees = answer["gap"] <= WITHIN
            outcome = "agrees" if agrees else "differs"
            outcome += f" ({answer['by']})" if "by" in answer else ""
            text = (
                f"{outcome}: {answer['gap']:.1e} in {answer['where'] or '-'} of {answer['signals']} signals"
            )
        else:
            outcome = answer["stage"]
            text = f"{outcome}: {answer['what'].splitlines()[0][:200]}"
        counts[outcome] += 1
        print(f"| {name} | {answer.get('states', '')} | {text} |", flush=True)
    worker.kill()
    print("\n" + ", ".join(f"{count} {what}" for what, count in counts.most_common()), f"of {len(names)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
