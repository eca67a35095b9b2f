"""The Modelica compiler in a process of its own: a request on the standard input, forms on the output.

Run as a file: importing the package would take longer than most models.
"""

import json
import sys


def main() -> int:
    """Compile; returns 1, with the message on the standard error, if the compiler refuses the model."""
    import rumoca

    asked = json.loads(sys.stdin.read())
    try:
        compiled = rumoca.Session(roots=asked["roots"]).load(asked["file"], model=asked["model"])
        forms = [f"{json.dumps(stage)}: {compiled.to_json(stage)}" for stage in asked["stages"]]
        sys.stdout.write(f"{{{', '.join(forms)}}}")
    except rumoca.RumocaError as error:
        print(str(error), file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
