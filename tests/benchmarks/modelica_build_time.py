"""How long builds of Modelica models take: `python -m tests.benchmarks.modelica_build_time`.

Prints wall and processor time of the first build on a machine (empty caches of the C compiler), of a later
one of a changed model, and of flat models of 5,000 equations, with and without events.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def chain(equations: int, events: bool, rate: float) -> str:
    """A chain of oscillators; with events, it counts where the first one crosses zero."""
    pairs = range(equations // 2)
    declared = "".join(f"  Real x{n}(start={n}, fixed=true), v{n}(start=0, fixed=true);\n" for n in pairs)
    drawn = {n: f" + k*(x{n - 1} - x{n})" if n else "" for n in pairs}
    motion = "".join(f"  der(x{n}) = v{n};\n  der(v{n}) = -k*x{n} - d*v{n}{drawn[n]};\n" for n in pairs)
    counter = "  Integer c(start=0, fixed=true);\n" if events else ""
    when = "  when x0 < 0 then\n    c = pre(c) + 1;\n  end when;\n" if events else ""
    head = f"model Chain\n  parameter Real k = {rate}, d = 0.1;\n{counter}"
    return f"{head}{declared}equation\n{motion}{when}end Chain;\n"


def built(folder: Path, text: str) -> tuple[float, float]:
    """Wall and processor time of a build [s]."""
    model = folder / "Chain.mo"
    model.write_text(text)
    caches = {
        "ZIG_GLOBAL_CACHE_DIR": str(folder / "zig"),
        "ZIG_LOCAL_CACHE_DIR": str(folder / "zig" / "local"),
    }
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    begun = time.monotonic()
    subprocess.run(
        [sys.executable, "-m", "orchestrator", "build", str(model), "-o", str(folder / "Chain.fmu")],
        check=True,
        stdout=subprocess.DEVNULL,
        env={**os.environ, **caches},
    )
    wall = time.monotonic() - begun
    now = resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--large", type=int, default=5000, help="equations of the large models")
    large = parser.parse_args().large
    for events in (False, True):
        name = "with events" if events else "without events"
        with tempfile.TemporaryDirectory() as scratch:
            for what, size, rate in (("first", 50, 2.0), ("later", 50, 2.5), ("later", large, 2.0)):
                wall, used = built(Path(scratch), chain(size, events, rate))
                print(f"{name}, {size} equations, {what}: {wall:.1f} s, processor {used:.1f} s", flush=True)


if __name__ == "__main__":
    main()
