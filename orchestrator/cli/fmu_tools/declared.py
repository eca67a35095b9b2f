"""Checks of what an FMU declares and brings, without running it."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path

from ...base.errors import listed
from ...fmi import Causality, Interface, Kind, ModelDescription
from ...fmi.archive import binary_folder
from .binaries import wanted_images
from .contents import Binary, binaries
from .finding import Finding, Level, Verdict, failed, passed


def declared_checks(path: Path, description: ModelDescription) -> list[Finding]:
    """All findings that need no running. Raises: FmuError if the archive cannot be read."""
    libraries = binaries(path, description)
    return [
        _archive(path),
        _description(path),
        *_binaries(description, libraries),
        _units(description),
        _starts(description),
    ]


def library_can_run(path: Path, description: ModelDescription) -> bool:
    """Whether there is a library for this platform."""
    platform = binary_folder(description.fmi_version)
    return any(one.platform == platform for one in binaries(path, description))


def _archive(path: Path) -> Finding:
    try:
        with zipfile.ZipFile(path) as archive:
            broken = archive.testzip()
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, RuntimeError, ValueError) as error:
        return failed("archive", Level.ERROR, f"It cannot be read to its end: {error}.", "Download it again.")
    if broken is not None:
        reason = f"Its entry {broken!r} is damaged: the checksum does not fit."
        return failed("archive", Level.ERROR, reason, "Export or download it again.")
    return passed("archive", "Every entry is read, its checksum fits, and none would be written elsewhere.")


def _description(path: Path) -> Finding:
    from fmpy.validation import validate_fmu

    problems = [" ".join(problem.split()) for problem in validate_fmu(str(path))]
    if problems:
        return failed(
            "description",
            Level.ERROR,
            f"fmpy finds {len(problems)} problems: {' / '.join(problems[:5])}",
            "Export it again with a tool that keeps to the standard.",
            problems=problems,
        )
    return passed("description", "fmpy's validation finds nothing.")


def _binaries(description: ModelDescription, libraries: list[Binary]) -> list[Finding]:
    platform = binary_folder(description.fmi_version)
    found = []
    if platform not in [one.platform for one in libraries]:
        found.append(
            failed(
                "binary",
                Level.ERROR,
                f"There is no library {description.model_identifier} for this platform, {platform}; "
                f"there are: {listed(one.platform for one in libraries)}.",
                f"Export it for {platform}, or compile its sources.",
            )
        )
    return found + [_binary(one, here=one.platform == platform) for one in libraries]


def _binary(one: Binary, here: bool) -> Finding:
    check, name = f"binary {one.platform}", one.file
    if one.problem:
        return failed(check, Level.ERROR, f"{name} is no library: {one.problem}.", "Export it again.")
    kinds = ", ".join(f"{image.kind} {image.architecture}" for image in one.images)
    wanted = wanted_images(one.platform)
    if wanted is None:
        return Finding(check, Verdict.NOT_TRIED, f"{one.platform} is no platform that is known here.")
    kind, architectures = wanted
    fitting = [image for image in one.images if image.kind == kind and image.architecture in architectures]
    if not fitting:
        reason = f"{name} is {kinds}; {one.platform} needs {kind} {' or '.join(architectures)}."
        return failed(check, Level.ERROR, reason, "Put each library into the folder of its platform.")
    if not all(image.shared for image in fitting):
        return failed(check, Level.ERROR, f"{name} is a program or an object file.", "Link it as a library.")
    if one.missing_core:
        reason = f"{name} does not export {listed(one.missing_core)}."
        return failed(check, Level.ERROR, reason, "Export them: check visibility and the model identifier.")
    if one.missing:
        reason = f"{name} exports {one.exported} functions of FMI, but not {listed(one.missing, 5)}."
        return failed(check, Level.WARNING, reason, "Some masters refuse FMUs that lack functions.")
    needs = one.foreign_needs
    more = f"; it needs {listed(needs)}, which not every system has" if needs else ""
    return passed(check, f"{kinds}, exports all {one.exported} functions{more}.", needs=list(needs))


def _units(description: ModelDescription) -> Finding:
    reals = [one for one in description.variables.values() if one.kind is Kind.REAL]
    unread = sorted({one.unit_name for one in reals if one.unit_name and one.unit is None})
    if unread:
        return failed(
            "units",
            Level.WARNING,
            f"Units that cannot be converted to SI: {listed(unread)}.",
            "Give each a BaseUnit in UnitDefinitions.",
        )
    bare = [
        one.name
        for one in reals
        if not one.unit_name and one.causality in (Causality.INPUT, Causality.OUTPUT)
    ]
    more = f"; {len(bare)} real inputs and outputs have none: {listed(bare, 3)}" if bare else ""
    return passed("units", f"Every unit that is given can be converted to SI{more}.", without=bare)


def _starts(description: ModelDescription) -> Finding:
    wrong = []
    for one in description.variables.values():
        low, high = one.minimum, one.maximum
        if low is not None and high is not None and low > high:
            wrong.append(f"{one.name}: minimum {low!r} is above maximum {high!r}")
        elif isinstance(one.start, int | float) and one.kind in (Kind.REAL, Kind.INTEGER):
            below, above = low is not None and one.start < low, high is not None and one.start > high
            if below or above:
                wrong.append(f"{one.name} = {one.start!r}, not in [{low!r}, {high!r}]")
    count = len(description.variables)
    if wrong:
        return failed(
            "start values",
            Level.ERROR,
            f"{len(wrong)} start values are out of range: {'; '.join(wrong[:5])}.",
            "Correct the start values or the ranges: masters that check them refuse the FMU.",
        )
    if description.interface is Interface.MODEL_EXCHANGE and description.tolerance is None:
        reason = "The FMU proposes no tolerance for its integration."
        return failed("start values", Level.WARNING, reason, "Give DefaultExperiment a tolerance.")
    return passed("start values", f"{count} variables, start values within their ranges.")
