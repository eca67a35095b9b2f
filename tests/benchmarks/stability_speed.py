"""How long `orchestrator stability` takes from the shell: ten states with three delays, 200 states with four.

`python -m tests.benchmarks.stability_speed` builds rods of heat-conducting cells as FMUs, closes a ring of
them through late connections, and times the command.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import orchestrator as orc

# Cells of each rod, and the longest time that the command may take [s].
CASES = {"10 states, 3 delays": ([4, 3, 3], 2.0), "200 states, 4 delays": ([50, 50, 50, 50], 20.0)}


def rod(cells: int) -> str:
    """A rod that is heated at one end and measured at the other."""
    lines = [f"model Rod{cells}", "  input Real heat(start = 0);", "  output Real hot;"]
    lines += [f"  Real t{k}(start = {0.01 * k}, fixed = true);" for k in range(cells)]
    lines += ["equation"]
    for k in range(cells):
        below = f"{cells} * (t{k - 1} - t{k})" if k else "heat - t0"
        above = f" + {cells} * (t{k + 1} - t{k})" if k + 1 < cells else ""
        lines.append(f"  der(t{k}) = {below}{above};")
    return "\n".join([*lines, f"  hot = t{cells - 1};", f"end Rod{cells};", ""])


def ring(folder: Path, sizes: list[int]) -> Path:
    """A ring of rods with a delay on each connection, one of negative gain. Returns: its config."""
    system = orc.System(step_size="10 ms", stop_time="10 s", master="jacobi")
    for place, cells in enumerate(sizes):
        source, fmu = folder / f"Rod{cells}.mo", folder / f"Rod{cells}.fmu"
        if not fmu.exists():
            source.write_text(rod(cells), encoding="utf-8")
            orc.build(source, fmu)
        system.add(f"rod{place}", str(fmu))
    for place in range(len(sizes)):
        effects = [{"delay": f"{100 + 37 * place} ms"}, {"gain": -2.0 if place == 0 else 1.0}]
        system.connect(f"rod{place}.hot", f"rod{(place + 1) % len(sizes)}.heat", *effects)
    config = folder / f"ring{len(sizes)}.yaml"
    orc.load(system.data).to_yaml(config)
    return config


def main() -> int:
    """Time all cases. Returns: 1 if one takes too long."""
    slow = False
    with tempfile.TemporaryDirectory() as name:
        for case, (sizes, allowed) in CASES.items():
            config = ring(Path(name), sizes)
            begin = time.perf_counter()
            command = [sys.executable, "-m", "orchestrator", "stability", str(config)]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            took = time.perf_counter() - begin
            slow |= took > allowed
            print(f"{case}: {took:.2f} s, allowed {allowed:g} s; {done.stdout.splitlines()[1]}")
    return int(slow)


if __name__ == "__main__":
    sys.exit(main())
