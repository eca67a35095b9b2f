"""The Modelica compiler in a process of its own: a request a line on the standard input, an answer a line.

Run as a file: importing the package would take longer than most models.
"""

import json
import os
import sys


def answered(asked):  # type: ignore[no-untyped-def]
    """The compiler's forms of a model by their names, or its refusal."""
    import rumoca

    try:
        # A session remembers the classes it has seen: one per model.
        compiled = rumoca.Session(roots=asked["roots"]).load(asked["file"], model=asked["model"])
        forms = [f"{json.dumps(stage)}: {compiled.to_json(stage)}" for stage in asked["stages"]]
        return f'{{"forms": {{{", ".join(forms)}}}}}'
    except BaseException as error:
        # A panic of the compiler is no Exception, and its class cannot be imported.
        panic = type(error).__name__ == "PanicException"
        if not isinstance(error, rumoca.RumocaError) and not panic:
            raise
        return json.dumps({"refusal": str(error), "panic": panic})


if __name__ == "__main__":
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what the compiler prints itself is no answer
    for line in sys.stdin:
        answers.write(answered(json.loads(line)).replace("\n", " ") + "\n")
        answers.flush()
