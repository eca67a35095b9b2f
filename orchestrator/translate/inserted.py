"""What is put into the source of a Python model when its FMU is built.

It mends faults of pythonfmu 0.7.0's loader, and does what that leaves undone.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Sequence
from pathlib import Path

from orchestrator.base.errors import BuildError

__all__ = ["appended", "memory_told", "own_source", "requirements_check"]

# Put before the model's own imports, where it has requirements: what is missing is shown by name and remedy,
# on the error stream as well, since pythonfmu passes on what is raised only where logging is asked for.
_CHECK = r"""

# --- inserted when the FMU was built: tells which packages are missing


def _check_requirements(name, wanted):
    import re
    import sys
    from importlib import metadata

    missing = []
    for item in wanted:
        package, least = re.fullmatch(r"([\w.-]+)(?:>=([\d.]+))?", item).groups()
        try:
            found = metadata.version(package)
        except metadata.PackageNotFoundError:
            missing.append((item, f"{item} is not installed"))
            continue
        older = [tuple(map(int, re.findall(r"\d+", text)[:3])) for text in (found, least or "0")]
        if least and older[0] < older[1]:
            missing.append((item, f"{item} is needed, {found} is installed"))
    if missing:
        place = f"the Python {sys.version_info[0]}.{sys.version_info[1]} in {sys.prefix}"
        packages = " ".join(f'"{item}"' for item, _ in missing)
        what = f"FMU {name}: in {place} {'; '.join(text for _, text in missing)}"
        message = f"{what}. Remedy: pip install {packages} there, or take the FMU's native form."
        print(message, file=sys.stderr, flush=True)
        raise ImportError(message)


_check_requirements({name!r}, {requirements!r})

"""

# Appended to the model's source, against two faults of pythonfmu 0.7.0's loader. When a method raises, it
# gives up its references to the class, the instance and the instance's log at once, and again when the
# instance is freed: without one more reference each, freeing an instance that has refused something ends the
# process. And at the end of the process it releases its state once more after that has been destroyed, which
# now and then corrupts the heap; releasing it while Python still runs leaves nothing to destroy.
_GUARD = """

# --- appended when the FMU was built: keeps pythonfmu's loader from releasing things twice


def _guard(method):
    import ctypes
    import functools

    @functools.wraps(method)
    def guarded(self, *arguments):
        try:
            return method(self, *arguments)
        except BaseException:
            for item in (type(self), self, self._get_log_queue()):
                ctypes.pythonapi.Py_IncRef(ctypes.py_object(item))
            raise

    return guarded


for _name in {methods}:
    setattr({name}, _name, _guard(getattr({name}, _name)))


def _releasing(initialise, seen=set()):
    import atexit
    import ctypes
    import functools
    import os
    import pathlib

    @functools.wraps(initialise)
    def initialise_and_register(self, **kwargs):
        initialise(self, **kwargs)
        folder = kwargs.get("resources")
        # Every unpacked copy of the FMU is a library of its own.
        for binary in pathlib.Path(folder or "").absolute().parent.glob("binaries/linux*/*.so"):
            if folder and binary not in seen:
                seen.add(binary)
                try:
                    loader = ctypes.CDLL(str(binary), mode=os.RTLD_NOLOAD | os.RTLD_NOW)
                except OSError:
                    continue  # loaded from somewhere else, or not at all
                atexit.register(loader.finalizePythonInterpreter)

    return initialise_and_register


{name}.__init__ = _releasing({name}.__init__)
"""
_GUARDED = (
    "setup_experiment",
    "enter_initialization_mode",
    "exit_initialization_mode",
    "do_step",
    "terminate",
    *(f"{way}_{kind}" for way in ("get", "set") for kind in ("integer", "real", "boolean", "string")),
    "_get_fmu_state",
    "_set_fmu_state",
)

# Appended before that: pythonfmu keeps no account of the order of calls. The words are those of the native
# form's runtime. Reading is illegal before initialisation alone, where it does no harm. A saved state carries
# where it was.
_ORDER = """

# --- appended when the FMU was built: refuses calls that FMI 2.0.4 (4.2.4, 2.2.7) forbids


def _keep_order(model):
    import functools
    import math

    made, initialising, stepping, ended = "Instantiated", "Initialization Mode", "Step Mode", "Terminated"
    names = ("causality", "variability", "initial")

    def refuse(self, what):
        raise RuntimeError(f"{self.instance_name}: {what}")

    def in_order(name, call, allowed, then):
        method = getattr(model, name)

        @functools.wraps(method)
        def ordered(self, *arguments):
            if self._fmi_state != allowed:
                refuse(self, f"{call}: illegal call in state {self._fmi_state}; allowed in: {allowed}")
            if name == "do_step":
                point, size = arguments
                if not (math.isfinite(point) and math.isfinite(size) and size > 0.0):
                    what = "both have to be finite, the step size above 0 s"
                    refuse(self, f"from {point:.9g} s by {size:.9g} s: {what}")
            result = method(self, *arguments)
            self._fmi_state = then
            return result

        setattr(model, name, ordered)

    def settable(variable):
        causality, variability, initial = (getattr(getattr(variable, one), "name", "") for one in names)
        if variability == "constant":
            return ()
        if causality == "input" or variability == "tunable" and causality == "parameter":
            return (made, initialising, stepping)
        if causality == "parameter" or initial in ("exact", "approx"):
            return (made, initialising)
        return ()

    def checked(name, call):
        method = getattr(model, name)

        @functools.wraps(method)
        def setting(self, references, values):
            states = self._fmi_settable
            if not states:
                for reference, variable in self.vars.items():
                    for state in settable(variable):
                        states.setdefault(state, set()).add(reference)
            if self._fmi_state == ended:
                legal = ", ".join((made, initialising, stepping))
                refuse(self, f"{call}: illegal call in state {ended}; allowed in: {legal}")
            if not states.get(self._fmi_state, set()).issuperset(references):
                for reference in references:
                    told(self, reference)
            return method(self, references, values)

        setattr(model, name, setting)

    def told(self, reference):
        if reference not in self.vars:
            last = len(self.vars) - 1
            refuse(self, f"Set: unknown value reference {reference}; {model.__name__} has 0 to {last}")
        variable = self.vars[reference]
        states = settable(variable)
        if not states:
            what = "cannot be set; inputs, independent parameters and free start values can"
            refuse(self, f"Set: {variable.name} (value reference {reference}) {what}")
        if self._fmi_state not in states:
            kind = "a fixed parameter" if variable.causality.name == "parameter" else "a start value"
            what = "it can be set before the end of initialisation only"
            refuse(self, f"Set: {variable.name} is {kind}: {what}")

    in_order("setup_experiment", "fmi2SetupExperiment", made, made)
    in_order("enter_initialization_mode", "fmi2EnterInitializationMode", made, initialising)
    in_order("exit_initialization_mode", "fmi2ExitInitializationMode", initialising, stepping)
    in_order("do_step", "fmi2DoStep", stepping, stepping)
    in_order("terminate", "fmi2Terminate", stepping, ended)
    for kind in ("Integer", "Real", "Boolean", "String"):
        checked(f"set_{kind.lower()}", f"fmi2Set{kind}")

    begin, save = model.__init__, model._get_fmu_state

    @functools.wraps(begin)
    def beginning(self, **options):
        self._fmi_state, self._fmi_settable = made, {}
        begin(self, **options)

    @functools.wraps(save)
    def saving(self):
        return {**save(self), "_fmi_state": self._fmi_state}

    model.__init__, model._get_fmu_state = beginning, saving


_keep_order({name})
"""


def requirements_check(name: str, requirements: Sequence[str]) -> str:
    """Code that looks for packages before a model's own imports.

    Args:
        name: of the model; requirements: such as "numpy>=2.4".
    """
    return _CHECK.replace("{name!r}", repr(name)).replace("{requirements!r}", repr(requirements))


def appended(name: str) -> str:
    """Code that goes after a model's own.

    Args:
        name: of its class.
    """
    return _ORDER.replace("{name}", name) + _GUARD.format(name=name, methods=_GUARDED)


def own_source(fmu: Path) -> str:
    """The model's own source in a Python FMU, as it was before its FMU was built.

    Raises: BuildError if it holds none, or not in one file.
    """
    try:
        with zipfile.ZipFile(fmu) as archive:
            module = archive.read("resources/slavemodule.txt").decode().split()[0]
            source = archive.read(f"resources/{module}.py").decode()
    except (OSError, KeyError, IndexError, UnicodeDecodeError, zipfile.BadZipFile) as error:
        raise BuildError(f"{fmu.name}: holds no source of a Python model: {error}") from error
    source = source.partition("\n\n# --- appended when the FMU was built")[0]
    begin = re.escape(_CHECK.lstrip("\n").splitlines()[0])
    return re.sub(rf"\n*{begin}.*?\n_check_requirements\('.*?\n", "\n", source, count=1, flags=re.DOTALL)


# What a model keeps beside what it registers is memory that its functions have to be told of.
_MEMORY = """

# --- appended for a native form: registers what the model remembers besides


def _telling_memory(initialise):
    import functools

    from pythonfmu import Fmi2Causality, Real

    @functools.wraps(initialise)
    def initialise_and_tell(self, **kwargs):
        initialise(self, **kwargs)
        known = {variable.name for variable in self.vars.values()}
        more = [name for name, value in vars(self).items() if type(value) is float and name not in known]
        for name in more:
            self.register_variable(Real(name, causality=Fmi2Causality.local, description="memory"))
        units = getattr(self, "type_attributes", {})
        self.type_attributes = {**units, **dict.fromkeys(more, {"unit": "1"})}

    return initialise_and_tell


{name}.__init__ = _telling_memory({name}.__init__)
"""


def memory_told(source: str) -> str:
    """A model's source with all numbers that it keeps registered: a native form has no other memory.

    Raises: BuildError if it has not one class of pythonfmu's.
    """
    names = re.findall(r"^class (\w+)\(\s*Fmi2Slave\s*\)\s*:", source, re.MULTILINE)
    if len(names) != 1:
        raise BuildError(f"classes derived from Fmi2Slave: {', '.join(names) or 'none'}; one is needed")
    return source + _MEMORY.replace("{name}", names[0])
