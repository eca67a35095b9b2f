"""The documentation site: pages outside docs/ that pages link to, and equations."""

from __future__ import annotations

import html
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files

_ROOT = Path(__file__).parents[1]
_OUTSIDE = ("fmus/*/README.md", "notebooks/*.ipynb", "orchestrator/config/systems/*.yaml")
_PAGES = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md"}


def on_files(files: Files, config: Any) -> Files:
    """Add the FMUs' pages, the notebooks and the contribution guide."""
    for pattern in _OUTSIDE:
        for path in sorted(_ROOT.glob(pattern)):
            files.append(File.generated(config, path.relative_to(_ROOT).as_posix(), abs_src_path=str(path)))
    files.append(File.generated(config, "contributing.md", abs_src_path=str(_ROOT / "CONTRIBUTING.md")))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Links as the repository has them -> as the site has them."""
    uri = page.file.src_uri
    if uri.startswith("fmus/"):
        return re.sub(r"\]\(\.\./\.\./docs/", "](../../", markdown)
    markdown = re.sub(r"\]\(docs/", "](", markdown)
    markdown = re.sub(r"\]\(\.\./(fmus|notebooks)/", r"](\1/", markdown)
    for name, place in _PAGES.items():
        markdown = re.sub(rf"\]\((?:\.\./)?{re.escape(name)}(?=[#)])", f"]({place}", markdown)
    return markdown


def on_page_content(content: str, **_: Any) -> str:
    """Equations in LaTeX -> MathML, which browsers show without a script."""
    return re.sub(
        r'(<(?:span|div) class="arithmatex">)(?:\\\((.*?)\\\)|\\\[(.*?)\\\])(?=</)',
        lambda found: found[1] + _equation(found[2] or found[3], "inline" if found[2] else "block"),
        content,
        flags=re.DOTALL,
    )


def _equation(latex: str, display: str) -> str:
    """Raises: ValueError if a command of LaTeX is not known to the converter."""
    made = convert(html.unescape(latex).strip(), display=display)
    if any(one in made for one in ("\\", "&#x0005C;", "&amp;", "&#x00026;")):
        raise ValueError(f"equation {latex.strip()!r}: {made} holds LaTeX that is not converted")
    return made
