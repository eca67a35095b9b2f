"""Python models that share modules: put together in order, once each, and refused where they cannot be."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator.base.errors import BuildError
from orchestrator.translate.shared_source import assembled, pieces


def model(folder: Path, text: str, **shared: str) -> Path:
    """A model's file beside a folder of shared modules."""
    (folder / "shared").mkdir()
    (folder / "Model").mkdir()
    for name, content in shared.items():
        (folder / "shared" / f"{name}.py").write_text(content, encoding="utf-8")
    path = folder / "Model" / "model.py"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_model_that_shares_nothing_stays_as_it_is(tmp_path):
    text = '"""Doc."""\nfrom __future__ import annotations\n\nx = 1\n'
    assert assembled(model(tmp_path, text)) == text


def test_shared_modules_stand_before_their_users_once(tmp_path):
    path = model(
        tmp_path,
        "from __future__ import annotations\n"
        "from shared.one import (\n    a,\n)\nfrom shared.two import b\nc = a + b\n",
        one="from __future__ import annotations\na = 1\ncount = globals().get('count', 0) + 1\n",
        two="from shared.one import a\nb = a + 1\n",
    )
    space: dict[str, object] = {}
    exec(assembled(path), space)
    assert (space["c"], space["count"]) == (3, 1)
    assert [piece.label for piece in pieces(path)] == ["shared/one.py", "shared/two.py", "model.py"]
    # Lines keep their numbers, for messages.
    assert pieces(path)[-1].text.split("\n")[5] == "c = a + b"


PLAIN = "shared code is imported at the top level and by plain names only: from shared.NAME import a, b"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("import shared.one\n", f"model.py:1: {PLAIN}"),
        ("def f():\n    from shared.one import a\n", f"model.py:2: {PLAIN}"),
        ("from shared.one import a as b\n", f"model.py:1: {PLAIN}"),
        ("from shared.two import a\n", "shared/three.py:1: shared/two.py imports this file in turn"),
    ],
)
def test_refusals(text, message, tmp_path):
    path = model(
        tmp_path, text, one="a = 1\n", two="from shared.three import a\n", three="from shared.two import a\n"
    )
    with pytest.raises(BuildError) as caught:
        assembled(path)
    assert str(caught.value) == message
