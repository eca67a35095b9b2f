"""The command `orchestrator stability`."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .arguments import add_config, add_json, one_matrix_thread

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Mapping

    from ..base.errors import Problem
    from ..frequency.over_parameter import ParameterRange
    from ..frequency.trim import Trimmed
    from ..simulation.preparation import Prepared


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `orchestrator stability`."""
    add_config(parser)
    parser.add_argument(
        "--open",
        action="append",
        default=[],
        metavar="INPUT",
        help="open the loop at what feeds this input, as drive.voltage; again: all at once, too",
    )
    parser.add_argument(
        "--at-time",
        metavar="TIME",
        help="linearise around this time of a run, as '2 s', in place of its start",
    )
    parser.add_argument(
        "--trim",
        action="store_true",
        help="linearise around the steady state, in place of the start values; inputs keep theirs",
    )
    parser.add_argument(
        "--fix",
        action="append",
        default=[],
        metavar="STATE",
        help="of --trim: a state that keeps its start value and may go on changing; may be given again",
    )
    parser.add_argument(
        "--over",
        action="append",
        default=[],
        metavar="PATH=LOW..HIGH",
        help="where the system becomes unstable over a parameter, as robot.tau_m='1..8 ms'; twice: a chart",
    )
    parser.add_argument(
        "--verify",
        action="store_true",
        help="co-simulate a small change, and compare its decay and frequency with the dominant root",
    )
    parser.add_argument(
        "--limit-cycles",
        action="store_true",
        help="oscillations that relays, play, dead band, saturation and others predict",
    )
    parser.add_argument(
        "--points",
        type=int,
        help="values of --over (default: 25; of a chart 200 a side, 50 with the communication step)",
    )
    parser.add_argument(
        "--out", metavar="DIR", help="write stability.html, stability.json and figures to this folder"
    )
    add_json(parser)


def main(args: argparse.Namespace) -> int:
    """Analyse a system. Returns: the exit code."""
    one_matrix_thread()
    from ..simulation.run import prepare

    report, words, draw = _analysed(prepare(args.config, args.overrides), args)
    if not args.json:
        print(words)
    files = []
    if args.out is not None:
        from ..plotting.figures import save

        folder = Path(args.out)
        folder.mkdir(parents=True, exist_ok=True)
        content = json.dumps(report, indent=2, allow_nan=False, ensure_ascii=False)
        (folder / "stability.json").write_text(content + "\n", encoding="utf-8")
        files.append("stability.json")
        figures = draw()
        images = {name: folder / f"{name}.png" for name in figures}
        for name, figure in figures.items():
            save(figure, images[name])
        from ..frequency.page import stability_page

        (folder / "stability.html").write_text(stability_page(report, images, words), encoding="utf-8")
        files += ["stability.html", *(one.name for one in images.values())]
        if not args.json:
            print(f"Written to {folder}: {', '.join(files)}")
    if args.json:
        document = {"exit_code": 0, "folder": args.out, "files": files, **report}
        print(json.dumps(document, allow_nan=False, ensure_ascii=False))
    return 0


_Analysis = tuple[dict[str, Any], str, "Callable[[], Mapping[str, Any]]"]


def _analysed(prepared: Prepared, args: argparse.Namespace) -> _Analysis:
    from ..base.errors import ConfigError, Problem
    from ..frequency.chart import config_chart
    from ..frequency.chart_report import chart_data, chart_figure, chart_text
    from ..frequency.from_system import linearise
    from ..frequency.over_parameter import over_figure, over_text, parameter_range, stability_over
    from ..frequency.system_report import system_figures, system_stability, system_text
    from ..frequency.trim import trim_text
    from ..results.measures import choose_measures

    at_time = None if args.at_time is None else _time(args.at_time)
    trimmed, overrides = None, tuple(args.overrides)
    if args.trim or args.fix:
        trimmed = _trimmed(prepared, args)
        prepared, overrides = trimmed.prepared, (*overrides, *trimmed.overrides)
    ranges = [parameter_range(one, args.points or 25) for one in args.over]
    if len(ranges) > 2:
        raise ConfigError([Problem("--over", f"{len(ranges)} ranges are given", "one, or two for a chart")])
    of_each = zip(args.over, ranges, strict=True)
    if refused := [one for text, over in of_each for one in _refused(prepared, text, over)]:
        raise ConfigError(refused)
    linear = linearise(prepared, at_time=at_time)
    report = system_stability(prepared, args.open, linear)
    words = system_text(report)
    for chosen in choose_measures(prepared.config):
        if (of_measure := getattr(chosen.measure, "stability", None)) is not None and at_time is None:
            report[chosen.name], lines = of_measure(prepared, linear, report, chosen.options)
            words = "\n".join([words, *lines])
    if trimmed is not None:
        report["trim"] = {name: vars(one) for name, one in trimmed.states.items()}
        words = f"{words}\n{trim_text(trimmed)}"
    fixed = args.fix if args.trim else None
    chart = None
    if len(ranges) == 1:
        report["over"] = stability_over(args.config, ranges[0], args.overrides, at_time, fixed)
        words = f"{words}\n{over_text(report['over'])}"
    if len(ranges) == 2:
        chart = config_chart(
            args.config, *ranges, args.overrides, at_time=at_time, trimmed=fixed, points=args.points
        )
        report["chart"] = chart_data(chart)
        words = f"{words}\n{chart_text(chart)}"

    if args.limit_cycles:
        from ..frequency.describing import limit_cycles, limit_cycles_text

        cycles = limit_cycles(prepared, linear)
        report["limit_cycles"] = [vars(one) for one in cycles]
        words = f"{words}\n{limit_cycles_text(cycles)}"
    if args.verify:
        from ..frequency.verify import verified, verify_text

        known = [
            hold(prepared, linear, chosen.options)
            for chosen in choose_measures(prepared.config)
            if (hold := getattr(chosen.measure, "hold", None)) is not None
        ]
        pushes = {name: value for one in known for name, value in one.items()}
        momentary = {complex(*one["root"]) for one in report["modes"] if one["holds_for"] is not None}
        held = pushes if known else None
        report["verify"] = verified(args.config, linear, overrides, held, momentary)
        words = f"{words}\n{verify_text(report['verify'])}"

    def draw() -> dict[str, Any]:
        figures = system_figures(report, linear)
        figures |= {"over": over_figure(report["over"])} if len(ranges) == 1 else {}
        return figures | ({"chart": chart_figure(chart)} if chart is not None else {})

    return report, words, draw


def _refused(prepared: Prepared, text: str, over: ParameterRange) -> list[Problem]:
    """What the config does not take of a range, by its first value."""
    from ..base.errors import ConfigError
    from ..simulation.run import prepare

    override = over.override(over.low)
    try:
        prepare(prepared.config, [override])
    except ConfigError as error:
        marks = f"--set {override}", f"--over {text}"
        return [replace(one, place=one.place.replace(*marks, 1)) for one in error.problems]
    return []


def _trimmed(prepared: Prepared, args: argparse.Namespace) -> Trimmed:
    from ..base.errors import ConfigError, Problem
    from ..frequency.trim import trim

    if args.at_time is not None:
        what = "a steady state and a time of a run are two operating points"
        raise ConfigError([Problem("--trim", what, "one of --trim and --at-time")])
    if not args.trim:
        raise ConfigError([Problem("--fix", "states are fixed for --trim alone", "", "Add --trim.")])
    return trim(prepared, args.fix)


def _time(text: str) -> float:
    """A time with its unit [s]. Raises: ConfigError."""
    from ..base.errors import ConfigError, Problem
    from ..base.quantities import Measure, quantity
    from ..base.units import parse_unit

    value = quantity("", Measure("s", parse_unit("s")), text, "--at-time")
    if isinstance(value, Problem):
        raise ConfigError([value])
    return value
